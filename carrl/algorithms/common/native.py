"""Compiles a function of tensors to native code once for this machine, and keeps the result between processes.

It is kept in a folder that only its user can write to, checked and bounded:

    FINGERPRINT.SHA256.pt2    a package, named after what was compiled and after its own bytes
    work-XXXXXXXX/            all that the compiler and the loader write while they are at work, and nowhere else
    work-XXXXXXXX.lock        locked by the process that works there, so that the left-overs of killed ones are known
"""

import fcntl
import hashlib
import logging
import os
import platform
import shutil
import stat
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.fx import GraphModule
from torch.fx.experimental.proxy_tensor import make_fx

from carrl.cache import CacheError, forget_least_used, is_own, own_cache_dir

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
    if not has_compiler():
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


def has_compiler() -> bool:
    """Whether there is the C++ compiler that torch would call."""
    return shutil.which(os.environ.get("CXX", "g++")) is not None


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
    _logger.warning(
        "Compiling the updates takes about half a minute; later runs with such networks and losses start at once."
    )
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


MAX_BYTES = 512 * 2**20
"""Packages beyond this, about 140 of them, are forgotten, the least recently used first."""

_cache_logger = logging.getLogger(__name__)


def open_cache() -> Path:
    """The cache folder, made if need be, without what killed processes left in it.

    Raises:
        CacheError: others can write to it, or put another folder in its place.
        OSError: it cannot be made.
    """
    folder = own_cache_dir()
    _remove_left_overs(folder)
    return folder


def find_package(cache: Path, fingerprint: str) -> Path | None:
    """The package that is kept under this fingerprint, now the most recently used; None without one.

    One whose bytes are not those that were kept is deleted.
    """
    for package in cache.glob(f"{fingerprint}.*.pt2"):
        with suppress(FileNotFoundError):  # another process may forget it meanwhile
            if _is_as_kept(package):
                os.utime(package)
                return package
            delete_package(package, "is damaged")
    return None


def delete_package(package: Path, reason: str) -> None:
    """Deletes a package that is no use; whoever needs its code compiles it again."""
    _cache_logger.warning("Compiled code '%s' %s; it is deleted.", package, reason)
    package.unlink(missing_ok=True)


def keep_package(cache: Path, fingerprint: str, package: Path) -> None:
    """Moves a package, which lies on the same disk, into the cache, and forgets others where there are too many.

    Where another process has kept the same code meanwhile, that will do.
    """
    if find_package(cache, fingerprint) is not None:
        return
    package.chmod(0o600)
    kept = cache / f"{fingerprint}.{_checksum(package)}.pt2"
    os.replace(package, kept)
    forget_least_used(cache, "*.pt2", MAX_BYTES, kept)


@contextmanager
def workspace(cache: Path) -> Iterator[Path]:
    """A private folder for temporary files of this process and of those that it starts; it is removed at the end."""
    descriptor, lock = tempfile.mkstemp(prefix="work-", suffix=".lock", dir=cache)
    folder = Path(lock).with_suffix("")
    caches = {"TORCHINDUCTOR_CACHE_DIR": f"{folder}/inductor", "TRITON_CACHE_DIR": f"{folder}/triton"}
    try:
        _lock(descriptor)
        folder.mkdir(mode=0o700)
        with _environment({"TMPDIR": str(folder), **caches}):
            yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        Path(lock).unlink(missing_ok=True)
        os.close(descriptor)


@contextmanager
def _environment(variables: Mapping[str, str]) -> Iterator[None]:
    """Sets environment variables for a while, and Python's own temporary folder to that in TMPDIR."""
    before, folder_before = {name: os.environ.get(name) for name in variables}, tempfile.tempdir
    os.environ.update(variables)
    tempfile.tempdir = variables["TMPDIR"]
    try:
        yield
    finally:
        tempfile.tempdir = folder_before
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _remove_left_overs(cache: Path) -> None:
    """Removes workspaces of processes that are gone: nobody holds their locks."""
    for lock in cache.glob("work-*.lock"):
        with suppress(FileNotFoundError), lock.open("rb") as file:
            if _lock(file.fileno()):
                shutil.rmtree(lock.with_suffix(""), ignore_errors=True)
                lock.unlink()


def _lock(descriptor: int) -> bool:
    """Whether the file could be locked; False also on a disk that has no locks, where left-overs stay."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _is_as_kept(package: Path) -> bool:
    """Whether it is a file of the user's alone with the checksum in its name."""
    status = package.lstat()
    if not (stat.S_ISREG(status.st_mode) and is_own(status)):
        return False
    return package.name.split(".")[1] == _checksum(package)


def _checksum(package: Path) -> str:
    with package.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
