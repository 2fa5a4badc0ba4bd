"""Damage to files, as hypothesis draws it."""

from hypothesis import strategies as st


def damaged(data, content):
    """The bytes of a file cut off somewhere, or with some of them changed."""
    content = bytearray(content)
    if data.draw(st.booleans()):
        return content[: data.draw(st.integers(0, len(content) - 1))]
    for _ in range(data.draw(st.integers(1, 8))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    return content
