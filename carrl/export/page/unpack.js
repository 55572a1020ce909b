// Arrays of numbers as the page holds them.

const ARRAYS = { "<f4": Float32Array, "<i4": Int32Array, "|u1": Uint8Array };

async function unpack([kind, base64]) {
  const packed = Uint8Array.from(atob(base64), (character) => character.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new ARRAYS[kind](await new Response(stream).arrayBuffer());
}
