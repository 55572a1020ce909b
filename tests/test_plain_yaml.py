"""YAML from strangers becomes a tree of bounded size, whatever its aliases stand for."""

import pytest
import yaml

from carrl.plain_yaml import MOST_DEPTH, MOST_EXPANDED, parse_yaml

DOUBLED = "\n".join(
    ["a0: &a0 [1, 1]", *(f"a{level}: &a{level} [*a{level - 1}, *a{level - 1}]" for level in range(1, 23))]
)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (DOUBLED, "line \\d+: its aliases stand for more than 1048576 characters"),
        (f"a: &a {'x' * 1000}\nb: [{', '.join(['*a'] * 2000)}]", "line 2: its aliases stand for more than"),
        ("&a [*a]", "line 1: an alias in this leads back to it; write a value"),
        ("b: &a {c: [*a]}", "line 1: an alias in this leads back to it"),
        ("[" * (MOST_DEPTH + 1) + "]" * (MOST_DEPTH + 1), "more than 64 lists or mappings stand within each other"),
        ("a: *nowhere", "line 1: this is not YAML: found undefined alias"),
    ],
    ids=["doubled", "long text", "list of itself", "mapping of itself", "deep", "undefined"],
)
def test_what_stands_for_too_much_is_refused_before_it_is_made(text, message):
    with pytest.raises(ValueError, match=message):
        parse_yaml(text.encode())


def test_aliases_that_stand_for_little_are_read_as_ever():
    text = "a: &a [1, 2]\nb: *a\nc: {d: *a, e: &e text, f: *e}\n"
    assert parse_yaml(text.encode()) == yaml.safe_load(text)


def test_what_an_alias_stands_for_is_counted_with_every_use():
    piece = MOST_EXPANDED // 8
    with_uses = "a: &a {text}\nb: [{uses}]".format
    assert len(parse_yaml(with_uses(text="x" * piece, uses=", ".join(["*a"] * 6)).encode())["b"]) == 6
    with pytest.raises(ValueError, match="stand for more"):
        parse_yaml(with_uses(text="x" * piece, uses=", ".join(["*a"] * 7)).encode())


def test_the_deepest_nest_that_is_read_is_read():
    assert parse_yaml(("[" * MOST_DEPTH + "]" * MOST_DEPTH).encode())
