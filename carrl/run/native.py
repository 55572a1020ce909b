"""Compiles a function of tensors to native code once for this machine, and keeps the result between processes."""

import hashlib
import logging
import os
import platform
import shutil
import tempfile
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.fx import GraphModule
from torch.fx.experimental.proxy_tensor import make_fx

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
    the trace. The code is kept in `cache_dir()`, under a name that any change of the function, the shapes, torch or the
    processor changes; the first compilation takes about half a minute, loading it again some milliseconds.

    Raises:
        CompilationError: there is no C++ compiler, or the function cannot be traced or compiled.
    """
    if shutil.which(os.environ.get("CXX", "g++")) is None:
        raise CompilationError("no C++ compiler is installed; install g++, or set CXX")
    try:
        graph = make_fx(lambda *tensors: function(*tensors))(*inputs)  # a lambda, since it refuses bound methods
        package = _private(cache_dir()) / f"{_fingerprint(graph, inputs)}.pt2"
        if not package.exists():
            _logger.warning("Compiling for this machine; this takes about half a minute, once.")
            _compile(graph, inputs, package)
        # What torch._inductor.aoti_load_package (torch 2.13) does, without two seconds of imports; its model also sorts
        # the arguments of every call first, in as much time as this one computes.
        loader = torch._C._aoti.AOTIModelPackageLoader(str(package), "model", False, 1, -1)
    except CompilationError:
        raise
    except Exception as error:  # tracer, exporter, compiler and loader each have errors of their own
        raise CompilationError(f"{type(error).__name__}: {str(error).splitlines()[0] if str(error) else ''}") from error
    native: NativeFunction = loader.run
    return native


def cache_dir() -> Path:
    """Where compiled code is kept: the user's own cache folder, for code in it is run."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "carrl"


def _private(folder: Path) -> Path:
    """The folder, made if need be, that nobody else can write to.

    Raises:
        CompilationError: others can.
    """
    folder.mkdir(parents=True, exist_ok=True, mode=0o700)
    status = folder.stat()
    if status.st_uid != os.getuid() or status.st_mode & 0o022:
        raise CompilationError(f"'{folder}' belongs to another user or can be written by others; chmod 700 it")
    return folder


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


def _compile(graph: GraphModule, inputs: Sequence[Tensor], package: Path) -> None:
    """Compiles into a file beside the package first, so that two processes may compile at once."""
    with tempfile.TemporaryDirectory(dir=package.parent) as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", FutureWarning)  # torch 2.13's exporter warns of torch's own code
        program = torch.export.export(graph, tuple(inputs))
        partial_package = torch._inductor.aoti_compile_and_package(
            program, package_path=f"{folder}/{package.name}", inductor_configs=_QUICK_TO_COMPILE
        )
        os.replace(partial_package, package)
