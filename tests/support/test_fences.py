"""The helper that runs the code of Markdown pages."""

import traceback

import pytest

from fences import Fence, fences, run_fences

PAGE = """\
# A page

```python
x = 1
```

Some text with `code`.

- An item:

  ```python
  def next():
      return x + 1
  ```

~~~text
```python
raise ValueError("only shown")
```
~~~

```{code-cell} python
y = next()
```

```bash
echo $((1 + 1)) > two.txt
```

```
raise
```
"""


@pytest.fixture
def page(tmp_path):
    path = tmp_path / "page.md"
    path.write_text(PAGE)
    return path


def test_fences_have_their_line_language_and_text(page):
    assert [(fence.line, fence.language) for fence in fences(page)] == [
        (4, "python"),
        (12, "python"),
        (17, "text"),
        (23, "python"),
        (27, "bash"),
        (31, ""),
    ]
    assert fences(page)[0] == Fence(4, "python", "x = 1\n")
    assert fences(page)[1].text == "def next():\n    return x + 1\n"


def test_fences_run_in_order_in_the_folder_and_share_names(page, tmp_path):
    names = run_fences(page, tmp_path)

    assert names["y"] == 2
    assert (tmp_path / "two.txt").read_text() == "2\n"


def test_an_exception_has_the_line_of_the_page(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("Text.\n\n```python\na = 1\nb = a / 0\n```\n")

    with pytest.raises(ZeroDivisionError) as caught:
        run_fences(page, tmp_path)

    last = traceback.extract_tb(caught.value.__traceback__)[-1]
    assert (last.filename, last.lineno) == (str(page), 5)


def test_a_failing_command_fails_with_its_line_and_output(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("```bash\necho here\nfalse\necho not here\n```\n")

    with pytest.raises(AssertionError, match=r"page\.md:2: exit status 1\nhere\n$"):
        run_fences(page, tmp_path)


def test_an_open_fence_is_an_error(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("```python\nx = 1\n")

    with pytest.raises(ValueError, match="never closed"):
        fences(page)
