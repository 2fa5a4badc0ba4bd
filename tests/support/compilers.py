"""Compilers of shading languages that run on Linux: errors of a text, empty without any.

naga compiles WGSL, glslang compiles GLSL and HLSL. Metal's compiler runs on macOS only, so clang parses MSL with
declarations in place of Metal's library.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

import fieldbake as fb
from browser import missing
from fieldbake import _core

STUB = Path(__file__).parent / "metal_stub.h"


def metal_errors(text: str) -> list[str]:
    """Errors of clang in an MSL text, with declarations in place of Metal's library."""
    index = pytest.importorskip("clang.cindex", reason="pip install libclang to parse MSL").Index.create()
    source = STUB.read_text() + re.sub(r"#include <.*?>", "", text)
    flags = [
        "-x",
        "c++",
        "-std=c++14",
        "-nostdinc",
        "-Wno-unknown-attributes",
        "-Xclang",
        "-cl-single-precision-constant",
    ]
    unit = index.parse("text.cpp", args=flags, unsaved_files=[("text.cpp", source)])
    return [str(found) for found in unit.diagnostics if found.severity >= 3]


def glsl_errors(tmp_path: Path, stage: str, text: str, *flags: str) -> str:
    """Errors of the reference compiler of GLSL; empty without any."""
    compiler = shutil.which("glslangValidator")
    if compiler is None:
        missing("there is no glslangValidator: install the package glslang-tools")
    path = tmp_path / f"text.{stage}"
    path.write_text(text)
    command = [compiler, *flags, str(path)]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    return result.stdout if result.returncode else ""


def hlsl_errors(tmp_path: Path, stage: str, text: str, entry: str = "main") -> str:
    """Errors of glslang in an HLSL text; empty without any."""
    return glsl_errors(tmp_path, stage, text, "-D", "-e", entry, "-V", "-o", str(tmp_path / "text.spv"))


def wgsl_errors(text: str) -> str:
    """Errors of naga in a WGSL text without an entry point; empty without any."""
    try:
        _core.shader_library("quadrics", text, "glsl")
    except fb.Error as error:
        return str(error)
    return ""
