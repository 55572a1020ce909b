"""YAML that nobody vouches for, as plain values: no objects, no merged mappings, no numbers of thousands of digits.

What comes out is a tree of bounded size: whoever walks it, follows its aliases or writes it out ends in bounded time.
"""

from collections.abc import Iterator
from typing import Any

import yaml

_LONGEST_NUMBER = 64
"""Characters; what is longer is read as text, since Python takes minutes to read a number of a million digits."""
MOST_EXPANDED = 2**20
"""Characters and values that a text may stand for, every alias written out."""
MOST_DEPTH = 64
"""Lists and mappings within each other."""
_MERGE = "tag:yaml.org,2002:merge"
_SafeLoader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)  # ten times faster where PyYAML has it


class _Loader(_SafeLoader):
    """PyYAML's safe loader without what makes a small file large or slow."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """A mapping in which every key stands once."""
        seen = set()
        for key, _ in node.value if isinstance(node, yaml.MappingNode) else ():
            if key.tag == _MERGE:
                raise yaml.constructor.ConstructorError(problem="mappings are not merged", problem_mark=key.start_mark)
            if isinstance(key, yaml.ScalarNode) and key.value in seen:
                problem = f"the key {key.value[:40]} stands in it twice; keep one of the two"
                raise yaml.constructor.ConstructorError(problem=problem, problem_mark=key.start_mark)
            seen.add(key.value if isinstance(key, yaml.ScalarNode) else None)
        values: dict[Any, Any] = super().construct_mapping(node, deep)
        return values

    def construct_short_number(self, node: yaml.ScalarNode) -> Any:
        """A whole number or another, or the text where that is too long for one."""
        if isinstance(node.value, str) and len(node.value) > _LONGEST_NUMBER:
            return node.value
        return self.construct_yaml_int(node) if node.tag.endswith(":int") else self.construct_yaml_float(node)


for _kind in ("int", "float"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_kind}", _Loader.construct_short_number)


def parse_yaml(content: bytes) -> Any:
    """The values of the one document in a YAML text; None where it is empty.

    Aliases share a value; written out they are at most `MOST_EXPANDED`, and none leads back to itself.

    Raises:
        ValueError: it is no such text; the message can stand behind the file's name and a colon.
    """
    try:
        loader = _Loader(content.decode("utf-8-sig"))
        try:
            node = loader.get_single_node()
            if node is None:
                return None
            _Expansion().of(node)
            return loader.construct_document(node)
        finally:
            loader.dispose()
    except yaml.MarkedYAMLError as error:
        line = f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""
        raise ValueError(f"{line}this is not YAML: {' '.join(str(error.problem).split())[:80]}") from None
    except _TooLargeError as error:
        raise ValueError(str(error)) from None
    except Exception:  # PyYAML's constructors raise whatever a text such as `!!bool maybe` leads them to
        raise ValueError("this is not a YAML text file") from None


class _TooLargeError(Exception):
    """A text that stands for too much; the message says why."""

    def __init__(self, node: yaml.Node, reason: str) -> None:
        super().__init__(f"line {node.start_mark.line + 1}: {reason}")


class _Expansion:
    """How much the nodes of a text stand for, each counted once and used as often as aliases use it."""

    def __init__(self) -> None:
        self._sizes: dict[yaml.Node, int | None] = {}  # None while a node's own parts are counted

    def of(self, node: yaml.Node, depth: int = 0) -> int:
        """Characters and values of a node, every alias in it written out."""
        size = self._sizes.get(node, 0)
        if size is None:
            raise _TooLargeError(node, "an alias in this leads back to it; write a value instead")
        if size:
            return size
        if depth >= MOST_DEPTH and isinstance(node, yaml.CollectionNode):
            raise _TooLargeError(node, f"more than {MOST_DEPTH} lists or mappings stand within each other")
        self._sizes[node] = None
        size = 1 + (len(node.value) if isinstance(node, yaml.ScalarNode) else 0)
        for part in _parts(node):
            size += self.of(part, depth + 1)
            if size > MOST_EXPANDED:
                raise _TooLargeError(node, f"its aliases stand for more than {MOST_EXPANDED} characters; shorten it")
        self._sizes[node] = size
        return size


def _parts(node: yaml.Node) -> Iterator[yaml.Node]:
    """A list's values, or a mapping's keys and values."""
    for part in node.value if isinstance(node, yaml.CollectionNode) else ():
        yield from part if isinstance(node, yaml.MappingNode) else (part,)
