"""YAML that nobody vouches for, as plain values: no objects, no merged mappings, no numbers of thousands of digits."""

from typing import Any

import yaml

_LONGEST_NUMBER = 64
"""Characters; what is longer is read as text, since Python takes minutes to read a number of a million digits."""
_MERGE = "tag:yaml.org,2002:merge"


class _Loader(yaml.SafeLoader):
    """PyYAML's safe loader without what makes a small file large or slow.

    Aliases stay: they share a value and do not copy it, unlike merged mappings.
    """

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

    Raises:
        ValueError: it is no such text; the message can stand behind the file's name and a colon.
    """
    try:
        return yaml.load(content.decode("utf-8-sig"), _Loader)
    except yaml.MarkedYAMLError as error:
        line = f"line {error.problem_mark.line + 1}: " if error.problem_mark else ""
        raise ValueError(f"{line}this is not YAML: {' '.join(str(error.problem).split())[:80]}") from None
    except Exception:  # PyYAML's constructors raise whatever a text such as `!!bool maybe` leads them to
        raise ValueError("this is not a YAML text file") from None
