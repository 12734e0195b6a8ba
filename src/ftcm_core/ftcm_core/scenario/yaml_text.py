# SPDX-License-Identifier: Apache-2.0
"""YAML, strictly: what is read the same way by everybody, with the line of everything for errors."""

from __future__ import annotations

import re
from typing import Any

import yaml

from ftcm_core.errors import ScenarioError, shown

MAX_MERGED = 10_000
"""Entries that the merge keys (``<<``) of one file may bring in."""


class _Loader(yaml.SafeLoader):
    """Safe YAML; reads ``1e4`` as a number (YAML 1.2).

    Refuses a key given twice, numbers that YAML 1.1 and 1.2 read differently, and merge keys that multiply.
    """

    merged = 0

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value in seen:
                raise yaml.constructor.ConstructorError(
                    None, None, f"the key {key.value!r} is given twice", key.start_mark
                )
            seen.add(key.value if isinstance(key, yaml.ScalarNode) else id(key))
        return super().construct_mapping(node, deep)

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        merges = [value for key, value in node.value if key.tag == "tag:yaml.org,2002:merge"]
        for merge in merges:
            for part in merge.value if isinstance(merge, yaml.SequenceNode) else [merge]:
                if isinstance(part, yaml.MappingNode):
                    self.flatten_mapping(part)
                    self.merged += len(part.value)
                if self.merged > MAX_MERGED:
                    raise yaml.constructor.ConstructorError(
                        None, None, f"merge keys bring in more than {MAX_MERGED} entries", node.start_mark
                    )
        super().flatten_mapping(node)

    def construct_number(self, node: yaml.ScalarNode) -> int | float:
        text = node.value.lstrip("+-")
        if ":" in text or re.fullmatch("0[0-7_]+", text):
            raise yaml.constructor.ConstructorError(
                None, None, f"{shown(node.value)} is a number in base {60 if ':' in text else 8} to some; "
                "write it in base 10", node.start_mark,
            )  # fmt: skip
        whole = node.tag.endswith(":int")
        return self.construct_yaml_int(node) if whole else self.construct_yaml_float(node)


for _tag in ("int", "float"):
    _Loader.add_constructor(f"tag:yaml.org,2002:{_tag}", _Loader.construct_number)


class _Dumper(yaml.SafeDumper):
    """Writes what :class:`_Loader` reads back: a text such as ``1e4`` in quotes."""


for _class in (_Loader, _Dumper):
    _class.add_implicit_resolver(
        "tag:yaml.org,2002:float",
        re.compile(r"^[-+]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)[eE][-+]?[0-9]+$"),
        list("-+0123456789."),
    )


def parse_yaml(text: str, origin: str) -> tuple[Any, dict[str, int]]:
    """Parse YAML safely.

    Args:
        text: the document.
        origin: what to call it in errors.

    Returns:
        The plain data and the line of every dotted path.

    Raises:
        ScenarioError: not YAML, with the line.
    """
    lines: dict[str, int] = {}
    visited: set[int] = set()

    def walk(node: yaml.Node, path: str, depth: int) -> None:
        if path in lines or depth > 8:
            return
        lines[path] = node.start_mark.line + 1
        if id(node) in visited:  # an alias
            return
        visited.add(id(node))
        if isinstance(node, yaml.MappingNode):
            for key, value in node.value:
                inner = f"{path}.{key.value}" if path else str(key.value)
                walk(value, inner, depth + 1)
                lines[inner] = key.start_mark.line + 1
        elif isinstance(node, yaml.SequenceNode):
            for i, value in enumerate(node.value[:1000]):
                walk(value, f"{path}.{i}", depth + 1)

    try:
        loader = _Loader(text)
        node = loader.get_single_node()
        if node is None:
            return None, lines
        walk(node, "", 0)
        return loader.construct_document(node), lines
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = f"{origin}:{mark.line + 1}" if mark else origin
        raise ScenarioError(f"{place}: not valid YAML: {error.problem or error.context}") from None
    except (
        yaml.YAMLError,
        RecursionError,
        ValueError,
        TypeError,
        ArithmeticError,
        LookupError,
        AttributeError,
    ) as error:
        # The library's own constructors raise all of these for values that do not fit an explicit tag.
        first = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise ScenarioError(f"{origin}: not valid YAML: {first[:120]}") from None


def dump_yaml(data: Any, *, unicode: bool) -> str:
    """Return plain data as YAML that :func:`parse_yaml` reads back equal.

    Args:
        data: what to write.
        unicode: whether characters beyond ASCII are written as they are.
    """
    return yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=unicode, default_flow_style=None)
