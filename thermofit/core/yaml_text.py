"""The one way in which YAML is read: 1e-4 is a number, a date is a text, a key given twice is an error."""

from __future__ import annotations

import re
from collections.abc import Hashable
from typing import Any

import yaml

from thermofit.core.errors import ThermofitError
from thermofit.core.files import TEXT_LIMIT


class _Loader(yaml.SafeLoader):
    """YAML 1.1 as in PyYAML, which takes 1e-4 for a text, makes dates, and keeps the last of two equal keys without a word."""

    text_keys = True

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Hashable, Any]:
        seen: set[str] = set()
        for key_node, _ in node.value:
            if key_node.tag == "tag:yaml.org,2002:merge":
                continue
            key = self.construct_object(key_node, deep=True)
            if self.text_keys and not isinstance(key, str):
                raise yaml.MarkedYAMLError(problem=f"the key {key!r} is not a text", problem_mark=key_node.start_mark)
            if repr(key) in seen:
                raise yaml.MarkedYAMLError(problem=f"the key '{key}' is given twice", problem_mark=key_node.start_mark)
            seen.add(repr(key))
        return super().construct_mapping(node, deep=deep)


_Loader.yaml_implicit_resolvers = {
    first: [(tag, pattern) for tag, pattern in resolvers if tag != "tag:yaml.org,2002:timestamp"]
    for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
}
_FLOAT = re.compile(r"^[-+]?([0-9]+(\.[0-9]*)?|\.[0-9]+)[eE][-+]?[0-9]+$")
_Loader.add_implicit_resolver("tag:yaml.org,2002:float", _FLOAT, list("-+.0123456789"))


LARGEST_TREE = 200_000
"""Values that a YAML text may stand for, every alias written out: a few lines of aliases of aliases stand for billions."""


def _written_out(node: yaml.Node, sizes: dict[yaml.Node, int], above: set[yaml.Node]) -> int:
    """Number of values of a node with every alias written out; MarkedYAMLError beyond `LARGEST_TREE` and where it holds itself."""
    if node in above:
        raise yaml.MarkedYAMLError(problem="an alias stands for a section that holds it", problem_mark=node.start_mark)
    if node not in sizes:
        inner: list[yaml.Node] = []
        if isinstance(node, yaml.SequenceNode):
            inner = node.value
        elif isinstance(node, yaml.MappingNode):
            inner = [part for pair in node.value for part in pair]
        above.add(node)
        sizes[node] = 1 + sum(_written_out(part, sizes, above) for part in inner)
        above.discard(node)
        if sizes[node] > LARGEST_TREE:
            problem = f"with its aliases written out this holds more than {LARGEST_TREE} values"
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=node.start_mark)
    return sizes[node]


def parse_yaml(text: str, source: str, error: type[ThermofitError], *, text_keys: bool = True) -> Any:
    """The content of a YAML text; `text_keys`: every key must be a text. Where it cannot be read, is longer than `TEXT_LIMIT` or
    stands for too many values, `error` with `source` and line."""
    if len(text) > TEXT_LIMIT:
        raise error(
            f"{source}: found {len(text)} characters of YAML, expected at most {TEXT_LIMIT}; put long tables into files of their own"
        )
    loader = None
    try:
        loader = _Loader(text)
        loader.text_keys = text_keys
        node = loader.get_single_node()
        if node is None:
            return None
        _written_out(node, {}, set())
        return loader.construct_document(node)
    except yaml.MarkedYAMLError as wrong:
        mark = wrong.problem_mark or wrong.context_mark
        where = f"{source}, line {mark.line + 1}" if mark else source
        begin = wrong.context_mark.line + 1 if wrong.context_mark else None
        context = f" ({wrong.context} that begins in line {begin})" if wrong.context and begin else ""
        raise error(f"{where}: {wrong.problem or wrong.context}{context}; expected YAML, correct the line") from None
    except (yaml.YAMLError, ValueError, OverflowError, RecursionError, AttributeError) as wrong:
        # Some tags and numbers fail inside the loader with plain Python errors.
        raise error(f"{source}: not valid YAML ({' '.join(str(wrong).split())[:120]}); correct the text") from None
    finally:
        if loader is not None:
            loader.dispose()
