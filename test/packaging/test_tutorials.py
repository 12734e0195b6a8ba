# SPDX-License-Identifier: Apache-2.0
"""The tutorials, followed as a reader does: every file written, every command run, every output compared."""

import importlib.util
import re
from pathlib import Path

import pytest

from domains import free_domain
from tutorials import Reader, blocks_of, difference

TUTORIALS = Path(__file__).resolve().parents[2] / "docs" / "tutorials"
LONG = {"reproduce", "tune", "compare"}
"""Those that take more than five seconds of a processor."""
NEEDS = {
    "reproduce": ("matplotlib",),
    "law": ("rclpy",),
    "fault": ("matplotlib",),
    "tune": ("optuna", "scipy"),
    "compare": ("scipy",),
    "notebook": ("rclpy", "pandas", "matplotlib"),
}


def marked(page):
    marks = [pytest.mark.slow]
    if page.stem in LONG:
        marks.append(pytest.mark.nightly)
    if "rclpy" in NEEDS.get(page.stem, ()):
        marks.append(pytest.mark.ros)
    return pytest.param(page, id=page.stem, marks=marks)


@pytest.mark.parametrize("page", [marked(p) for p in sorted(TUTORIALS.glob("*.md"))])
def test_a_reader_comes_to_its_end(page, tmp_path):
    for module in NEEDS.get(page.stem, ()):
        pytest.importorskip(module, reason=f"{module} is not installed")
    reader = Reader(tmp_path, free_domain() if importlib.util.find_spec("rclpy") else None)
    try:
        reader.follow(page)
    finally:
        reader.close()


# ---- the reader notices what is wrong ----


@pytest.fixture
def follow(tmp_path):
    """Follow a page that is given as its text."""
    page = tmp_path / "page.md"
    reader = Reader(tmp_path, None)

    def following(text):
        page.write_text(text, "utf-8")
        reader.follow(page)

    yield following
    reader.close()


RIGHT = """
```python
# mine.py
def double(x):
    return 2 * x
```

```python
# mine.py, continued
HALF = 0.5
```

```
python -c 'import mine; print("it is", mine.double(1.23456))'
```

```text
it is 2.469
```

```python
from mine import HALF, double

double(HALF)
```

```text
1.0
```
"""


def test_a_page_that_is_right_is_followed(follow):
    follow(RIGHT)


@pytest.mark.parametrize(
    ("there", "instead", "text"),
    [
        ("2.469", "2.479", "page.md:17: not printed as it is shown"),
        ("1.0", "1.5", "page.md:27: not printed as it is shown"),
        ("python -c", "pyhton -c", "page.md:13: exit status 127"),
        ("double(HALF)", "double(HALFS)", "page.md:21: Traceback"),
        ("# mine.py, continued", "# mine.py", "page.md:8: mine.py is there"),
        ("import HALF", "import HALVES", "cannot import name 'HALVES'"),
    ],
)
def test_what_is_wrong_is_told_with_its_line(follow, there, instead, text):
    assert there in RIGHT
    with pytest.raises(AssertionError, match=re.escape(text)):
        follow(RIGHT.replace(there, instead))


@pytest.mark.parametrize(
    ("shown", "printed"),
    [
        ("a\n...\nd", "a\nb\nc\nd"),
        ("...\nc\n...", "a\nb\nc\nd"),
        ("...", "a"),
        ("| x | 1.23 |\n|---|---|", "| x   |   1.234 |\n|-----|------|"),
        ("2.7e-08 to 1.21e+03", "2.71e-08 to 1.209e+03"),
        ("126 (118 to 130)", "126 (118 to 131)"),
        ("0.008692", "0.008698"),  # 7e-4 of it
    ],
)
def test_what_agrees(shown, printed):
    assert difference(shown, printed) == ""


@pytest.mark.parametrize(
    ("shown", "printed"),
    [
        ("a\nd", "a\nb\nc\nd"),
        ("a\n...\nd", "a\nd\ne"),
        ("...\nc\nb\n...", "a\nb\nc\nd"),
        ("a", "a\nb"),
        ("1.23", "1.25"),
        ("2.7e-08", "2.7e-07"),
        ("2,001 ticks", "2,002 ticks"),
        ("12 runs", "13 runs"),
        ("-1.5", "1.5"),
        ("joint2 0.5", "joint3 0.5"),
        ("100 %", "99.62 %"),
        ("1.0", "0"),
        ("anything", ""),
    ],
)
def test_what_does_not_agree(shown, printed):
    assert difference(shown, printed) != ""


def test_a_block_that_nothing_is_done_with_is_refused():
    with pytest.raises(ValueError, match="line 3: a block of 'yaml' without the name of its file"):
        blocks_of("# A\n\n```yaml\nrobot: puma560\n```\n")
