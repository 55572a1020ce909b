"""Compiles a function of tensors to native code once for this machine, and keeps the result between processes."""

import hashlib
import logging
import os
import platform
import shutil
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.fx import GraphModule
from torch.fx.experimental.proxy_tensor import make_fx

from carrl.algorithms.common.package_cache import (
    CacheError,
    delete_package,
    find_package,
    keep_package,
    open_cache,
    workspace,
)

_logger = logging.getLogger(__name__)


_QUICK_TO_COMPILE = {
    "cpp.vec_isa_ok": True,  # torch has asked the processor already; Inductor would compile a program for each answer
    "aot_inductor.precompile_headers": False,  # pays off after several compilations
    "aot_inductor.compile_wrapper_opt_level": "O0",  # the wrapper only calls the kernels
}


class CompilationError(Exception):
    """A function cannot be compiled here; the message says why."""


NativeFunction = Callable[[list[Tensor]], list[Tensor]]


def compile_native(function: Callable[..., Any], inputs: Sequence[Tensor]) -> NativeFunction:
    """Traces `function` on these inputs and returns it as native code for lists of inputs of the same shapes and types.

    It returns a tensor or a tuple of them, the native code a list.

    What the function does to its inputs in place, the native code does too. Python branches are taken as they were in
    the trace. The code is kept in the cache folder, under a name that any change of the function, the shapes, torch or
    the processor changes; the first compilation takes about half a minute, loading it again some milliseconds.

    Raises:
        CompilationError: there is no C++ compiler, or the function cannot be traced or compiled.
    """
    if shutil.which(os.environ.get("CXX", "g++")) is None:
        raise CompilationError("no C++ compiler is installed; install g++, or set CXX")
    try:
        cache = open_cache()
        with workspace(cache) as folder:
            graph = make_fx(lambda *tensors: function(*tensors))(*inputs)  # a lambda, since it refuses bound methods
            fingerprint = _fingerprint(graph, inputs)
            return _load_kept(cache, fingerprint) or _compile(graph, inputs, folder, cache, fingerprint)
    except CacheError as error:
        raise CompilationError(str(error)) from error
    except Exception as error:  # tracer, exporter, compiler and loader each have errors of their own
        raise CompilationError(f"{type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}") from error


def _load_kept(cache: Path, fingerprint: str) -> NativeFunction | None:
    """Code that was compiled before; None where there is none, or none that can be loaded here any more."""
    package = find_package(cache, fingerprint)
    if package is None:
        return None
    try:
        return _load(package)
    except RuntimeError:
        delete_package(package, "cannot be loaded")
        return None


def _load(package: Path) -> NativeFunction:
    """The code in a package; the loader unpacks it into the workspace and needs the files there no longer than this."""
    # What torch._inductor.aoti_load_package (torch 2.13) does, without two seconds of imports; its model also sorts
    # the arguments of every call first, in as much time as this one computes.
    native: NativeFunction = torch._C._aoti.AOTIModelPackageLoader(str(package), "model", False, 1, -1).run
    return native


def _fingerprint(graph: GraphModule, inputs: Sequence[Tensor]) -> str:
    constants = {name: value.tolist() for name, value in [*graph.named_buffers(), *graph.named_parameters()]}
    parts: tuple[Any, ...] = (
        graph.code,
        sorted(constants.items()),
        [(tuple(value.shape), value.stride(), value.dtype, value.device) for value in inputs],
        torch.__version__,
        torch.get_num_threads(),
        torch.backends.cpu.get_cpu_capability(),
        platform.machine(),
    )
    return hashlib.sha256(repr(parts).encode()).hexdigest()[:32]


def _compile(
    graph: GraphModule, inputs: Sequence[Tensor], folder: Path, cache: Path, fingerprint: str
) -> NativeFunction:
    """Compiles in the workspace and keeps what can be loaded; several processes may compile the same at once."""
    _logger.warning("Compiling for this machine; this takes about half a minute, once.")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # torch 2.13's exporter warns of torch's own code
        program = torch.export.export(graph, tuple(inputs))
        with _forgotten_paths():
            path = torch._inductor.aoti_compile_and_package(
                program, package_path=f"{folder}/package.pt2", inductor_configs=_QUICK_TO_COMPILE
            )
    native = _load(Path(path))
    keep_package(cache, fingerprint, Path(path))
    return native


@contextmanager
def _forgotten_paths() -> Iterator[None]:
    """Lets Inductor remember no file of an earlier workspace here, and none of this one afterwards."""
    from torch._inductor.utils import clear_caches  # here, since loading needs none of Inductor, which imports slowly

    clear_caches()
    try:
        yield
    finally:
        clear_caches()
