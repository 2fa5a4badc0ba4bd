"""Constants that Rust and WGSL share are defined in Rust only, which writes them into the kernels."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[2]

#: Shaders of scenes, whose constants are still written twice.
SCENES = ("shaders/scene/", "shaders/shared/scene/")

CONST = re.compile(
    r"^\s*(?:pub(?:\([a-z]+\))? )?const ([A-Z][A-Z_0-9]+)\s*(?::\s*[\w<>]+)?\s*=\s*([^;]+);", re.MULTILINE
)
SHARED = re.compile(r"^        ([A-Z][A-Z_0-9]+): \w+ as \w+ = ", re.MULTILINE)


def value(text):
    """Evaluate a constant expression of Rust or WGSL; None if it is not constant."""
    text = text.strip().replace("u32::MAX", "0xffffffff").replace("f32::EPSILON", "1.1920929e-7")
    # Types: suffixes and casts.
    text = re.sub(r"_?(?:u32|i32|f32|f64|usize|u64)\b| as \w+", "", text).replace("_", "")
    text = re.sub(r"(?<=\d)[uif]\b|(?<=0x[\da-fA-F]{8})u\b", "", text)
    if not re.fullmatch(r"[\d.\sxa-fA-Fe+\-*/<()]+", text):
        return None
    try:
        # Eight digits: float32 constants are written with as many.
        return float(f"{float(eval(text)):.8g}")
    except (SyntaxError, NameError, ValueError):
        return None


def constants(folder, pattern):
    for path in sorted((ROOT / folder).rglob(pattern)):
        for name, text in CONST.findall(path.read_text(encoding="utf-8").partition("#[cfg(test)]\nmod tests")[0]):
            yield path.relative_to(ROOT).as_posix(), name, value(text)


def test_numbers_of_both_languages_are_read():
    assert value("0x80000000u") == value("1 << 31") == 2147483600
    assert value("5.9604645e-8") == value("1.0 / (1 << 24)")
    assert value("16_384") == value("16384u") == 16384
    assert value("LEAF + 1") is None


def test_no_constant_has_one_name_and_value_in_both_languages():
    rust = {(name, number) for _, name, number in constants("src", "*.rs")}
    twins = [(path, name) for path, name, number in constants("shaders", "*.wgsl") if number and (name, number) in rust]

    assert [twin for twin in twins if not twin[0].startswith(SCENES)] == []


def test_no_shader_defines_a_constant_of_its_group_again():
    groups = (ROOT / "src/gpu/constants.rs").read_text(encoding="utf-8").split("\nwgsl_constants! {\n")[-1]
    found = 0
    for group, body in re.findall(r"^    (\w+) \{\n(.*?)^    \}$", groups, re.MULTILINE | re.DOTALL):
        paths = [path for path in (ROOT / "shaders").rglob(f"{group}.wgsl") if path.parent.name != "atlas"]
        assert len(paths) == 1, group
        text = paths[0].read_text(encoding="utf-8")
        for name in SHARED.findall(body):
            found += 1
            assert not re.search(rf"^const {name}\b", text, re.MULTILINE), (group, name)
    assert found > 50
