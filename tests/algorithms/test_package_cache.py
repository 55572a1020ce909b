"""Where compiled code is kept: whose it is, damage, how much of it there is, and what killed processes leave."""

import os
import shutil
import sys
import tempfile
import warnings
from pathlib import Path

import pytest
import torch

from carrl.algorithms.common import native
from carrl.algorithms.common.native import (
    CompilationError,
    compile_native,
    find_package,
    keep_package,
    open_cache,
    workspace,
)
from carrl.cache import CacheError, cache_dir

needs_compiler = pytest.mark.skipif(shutil.which("g++") is None, reason="there is no C++ compiler to compile with")
CONTENT = b"0123456789"


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """A cache folder with nothing in it."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    return open_cache()


def keep(cache, fingerprint="abc", content=CONTENT):
    """The path of a stand-in for a package, now kept."""
    with workspace(cache) as folder:
        (folder / "package.pt2").write_bytes(content)
        keep_package(cache, fingerprint, folder / "package.pt2")
    found = find_package(cache, fingerprint)
    assert found is not None
    return found


DAMAGE = {
    "a flipped bit": lambda path: path.write_bytes(bytes([CONTENT[0] ^ 1]) + CONTENT[1:]),
    "a byte less": lambda path: path.write_bytes(CONTENT[:-1]),
    "a byte more": lambda path: path.write_bytes(CONTENT + b"0"),
    "nothing in it": lambda path: path.write_bytes(b""),
    "others may write to it": lambda path: path.chmod(0o602),
    "its group may": lambda path: path.chmod(0o620),
    "a link to another file": lambda path: path.rename(path.parent / "target") and path.symlink_to("target"),
}


@pytest.mark.parametrize("damage", DAMAGE.values(), ids=DAMAGE.keys())
def test_a_package_that_is_not_as_it_was_kept_is_deleted(damage, cache, caplog):
    path = keep(cache)
    damage(path)
    assert find_package(cache, "abc") is None
    assert not os.path.lexists(path)
    assert f"'{path}' is damaged; it is deleted" in caplog.text


def test_a_package_is_found_whole_whatever_the_umask(cache, caplog):
    before = os.umask(0)
    try:
        path = keep(cache)
    finally:
        os.umask(before)
    assert (path.read_bytes(), path.stat().st_mode & 0o777) == (CONTENT, 0o600)
    assert find_package(cache, "ab") is None
    assert list(cache.iterdir()) == [path]
    assert caplog.text == ""


def test_two_processes_may_compile_the_same_at_once(cache):
    """Compilers do not make the same bytes twice; those of the first one to end are kept."""
    with workspace(cache) as first, workspace(cache) as second:
        assert first != second
        for folder, content in ((first, b"first"), (second, b"second")):
            (folder / "package.pt2").write_bytes(content)
            keep_package(cache, "abc", folder / "package.pt2")
    (kept,) = cache.iterdir()
    assert kept.read_bytes() == b"first"
    keep(cache, "another")
    kept.write_bytes(b"damaged")
    assert keep(cache, "abc").read_bytes() == CONTENT


def test_the_least_recently_used_packages_are_forgotten(cache, monkeypatch):
    monkeypatch.setattr(native, "MAX_BYTES", 3 * len(CONTENT))
    paths = [keep(cache, name) for name in ("a", "b", "c")]
    for age, path in enumerate(paths, start=1):
        os.utime(path, (1000 - age, 1000 - age))
    oldest_now_used = find_package(cache, "c")
    newest = keep(cache, "d")
    assert set(cache.glob("*.pt2")) == {paths[0], oldest_now_used, newest}
    assert find_package(cache, "b") is None


def test_a_package_larger_than_the_cache_is_kept_alone(cache, monkeypatch):
    monkeypatch.setattr(native, "MAX_BYTES", 1)
    keep(cache, "a")
    newest = keep(cache, "b")
    assert list(cache.glob("*.pt2")) == [newest]


@pytest.mark.parametrize("mode", [0o777, 0o770, 0o707])
def test_a_folder_that_others_can_write_to_is_refused(mode, cache):
    cache.chmod(mode)
    with pytest.raises(CacheError, match=r"can be written by others; remove it"):
        open_cache()


def test_a_folder_that_others_can_replace_is_refused(cache):
    cache.parent.chmod(0o777)
    with pytest.raises(CacheError, match=r"can be replaced by others, who can write to '.*cache'; chmod o-w"):
        open_cache()
    cache.parent.chmod(0o1777)  # as /tmp is: nobody can rename what is another's
    assert open_cache() == cache


def test_a_link_that_others_can_replace_is_refused(cache, tmp_path, monkeypatch):
    (tmp_path / "shared").mkdir()
    (tmp_path / "shared").chmod(0o777)
    (tmp_path / "shared" / "link").symlink_to(cache.parent)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "shared" / "link"))
    with pytest.raises(CacheError, match=r"can write to '.*shared'"):
        open_cache()


def test_a_folder_of_another_user_is_refused(cache, monkeypatch):
    monkeypatch.setattr(os, "getuid", lambda: cache.stat().st_uid + 1)
    with pytest.raises(CacheError, match="belongs to another user"):
        open_cache()


@pytest.mark.parametrize("fails", [False, True])
def test_a_workspace_is_private_and_gone_at_the_end(fails, cache, monkeypatch):
    monkeypatch.setenv("TORCHINDUCTOR_CACHE_DIR", "before")
    monkeypatch.delenv("TRITON_CACHE_DIR", raising=False)
    environment, temporary = dict(os.environ), tempfile.gettempdir()
    try:
        with workspace(cache) as folder:
            assert folder.stat().st_mode & 0o777 == 0o700
            assert os.environ["TMPDIR"] == tempfile.gettempdir() == str(folder)
            assert Path(os.environ["TORCHINDUCTOR_CACHE_DIR"]).parent == folder
            assert Path(os.environ["TRITON_CACHE_DIR"]).parent == folder
            (folder / "left").mkdir()
            if fails:
                raise KeyboardInterrupt
    except KeyboardInterrupt:
        assert fails
    assert (dict(os.environ), tempfile.gettempdir()) == (environment, temporary)
    assert list(cache.iterdir()) == []


def test_left_overs_of_killed_processes_are_removed_and_nothing_else(cache):
    (cache / "work-killed.lock").touch()
    (cache / "work-killed" / "inductor").mkdir(parents=True)
    (cache / "work-killed-before-it-began.lock").touch()
    (cache / "of-somebody-else").mkdir()
    path = keep(cache)
    with workspace(cache) as folder:
        open_cache()
        assert {*cache.iterdir()} == {path, cache / "of-somebody-else", folder, folder.with_suffix(".lock")}


def doubled(values):
    return values * 2 + 1


WRITES: list[str] | None = None
"""Where this process writes and what its programs are told to use, while it is a list."""


def watch(event, arguments):
    if WRITES is None:
        return
    if event == "open" and isinstance(arguments[2], int) and arguments[2] & (os.O_WRONLY | os.O_RDWR):
        WRITES.append(os.fspath(arguments[0]) if not isinstance(arguments[0], int) else "")
    elif event in ("os.mkdir", "tempfile.mkdtemp", "tempfile.mkstemp"):
        WRITES.append(str(arguments[0]))
    elif event == "subprocess.Popen":
        WRITES.append(os.environ["TMPDIR"])


@pytest.fixture(scope="module")
def compiled(tmp_path_factory):
    """A cache folder with one small function compiled in it, and all places that were written to meanwhile."""
    global WRITES
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        sys.addaudithook(watch)
        WRITES = []
        try:
            with warnings.catch_warnings(action="ignore", category=DeprecationWarning):  # torch's, of itself
                code = compile_native(doubled, [torch.zeros(3)])
        finally:
            written, WRITES = WRITES, None
        assert code([torch.ones(3)])[0].tolist() == [3.0, 3.0, 3.0]
        yield cache_dir(), [path for path in written if path not in ("", os.devnull)]


@pytest.fixture
def copied(compiled, tmp_path, monkeypatch):
    """The one package, in a cache folder of this test's own; what would be compiled is counted instead."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    (package,) = compiled[0].iterdir()
    shutil.copy(package, open_cache())
    compilations = []
    monkeypatch.setattr(native, "_compile", lambda *arguments: compilations.append(arguments) or doubled)
    return cache_dir() / package.name, compilations


@needs_compiler
def test_the_compiler_writes_into_the_private_folder_only(compiled):
    cache, written = compiled
    assert len(written) > 20
    assert [path for path in written if not Path(path).is_relative_to(cache)] == []
    assert [path.suffix for path in cache.iterdir()] == [".pt2"]


@needs_compiler
def test_kept_code_runs_without_being_compiled_and_leaves_nothing(copied):
    package, compilations = copied
    code = compile_native(doubled, [torch.zeros(3)])
    assert code([torch.full((3,), 2.0)])[0].tolist() == [5.0, 5.0, 5.0]
    del code
    assert compilations == []
    assert list(cache_dir().iterdir()) == [package]


@needs_compiler
@pytest.mark.parametrize("size", [0, 1000, -1])
def test_a_cut_package_is_compiled_anew(size, copied):
    package, compilations = copied
    package.write_bytes(package.read_bytes()[:size])
    assert compile_native(doubled, [torch.zeros(3)]) is doubled
    assert len(compilations) == 1
    assert not package.exists()


@needs_compiler
def test_a_package_that_cannot_be_loaded_is_compiled_anew(copied, caplog):
    """As after a change of the machine that its name does not tell of."""
    package, compilations = copied
    package.unlink()
    keep(cache_dir(), package.name.split(".")[0], b"whole, but no package")
    assert compile_native(doubled, [torch.zeros(3)]) is doubled
    assert len(compilations) == 1
    assert "cannot be loaded; it is deleted" in caplog.text
    assert list(cache_dir().iterdir()) == []


def test_a_failed_compilation_leaves_nothing(cache, monkeypatch):
    def fail(graph, inputs, folder, *_):
        (folder / "half.cpp").touch()
        raise RuntimeError("the compiler fails")

    monkeypatch.setattr(native, "_compile", fail)
    monkeypatch.setattr(shutil, "which", lambda name: name)
    with pytest.raises(CompilationError, match="RuntimeError: the compiler fails"):
        compile_native(doubled, [torch.zeros(3)])
    assert list(cache.iterdir()) == []
