"""The drawing of an encode in docs/design.md: its names are those of the code, in the order in which they run."""

from __future__ import annotations

import ast
import inspect
import re

from sgmethod.rd import encode as rd
from tests.support.data import ROOT


def steps_of(function: str) -> list[str]:
    """What a function of rd/encode.py calls with the plan, in order, each name once."""
    tree = ast.parse(inspect.getsource(getattr(rd, function)))
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and node.args]
    calls.sort(key=lambda call: (call.lineno, call.col_offset))
    names = [ast.unparse(call.func) for call in calls if ast.unparse(call.args[0]) == "plan"]
    return [step for name in dict.fromkeys(names) for step in (steps_of(name) if name == "run" else [name])]


def test_the_drawing_of_an_encode_has_the_names_of_the_code() -> None:
    drawing = (ROOT / "docs" / "design.md").read_text().partition("DECODE")[0]
    arguments = re.findall(r"rd/encode\((.*)\)", drawing)
    assert arguments == [", ".join(inspect.signature(rd.encode).parameters)]
    drawn = re.findall(r"^ +\|   (\w+)  +\w.*\|   \S", drawing, re.MULTILINE)
    assert len(drawn) > 5
    assert drawn == steps_of("encode")
