"""Files as a whole, onto the disk and from it."""

import tracemalloc

import pytest

from carrl.errors import CarrlError
from carrl.files import read_whole


def test_a_small_file_takes_little_memory_however_large_it_might_be(tmp_path):
    (tmp_path / "small").write_bytes(b"abc")
    tracemalloc.start()
    try:
        assert read_whole(tmp_path / "small", 2**34, "a file") == b"abc"
        assert tracemalloc.get_traced_memory()[1] < 2**26
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("size", [2**24 - 1, 2**24, 2**24 + 1])
def test_a_file_is_read_in_full_up_to_its_limit(tmp_path, size):
    content = bytes(range(256)) * (size // 256) + b"\1" * (size % 256)
    (tmp_path / "large").write_bytes(content)
    assert read_whole(tmp_path / "large", size, "a file") == content
    with pytest.raises(CarrlError, match=f"^a file: the file is too large; it may have at most {size - 1} bytes$"):
        read_whole(tmp_path / "large", size - 1, "a file")
