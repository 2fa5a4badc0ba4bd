"""Pages that come from other files: documents of the repository's root, the table of all files, the command line."""

from __future__ import annotations

import re
from pathlib import Path

import typer
from file_table import cell, files
from sphinx.application import Sphinx
from typer.core import TyperCommand, TyperGroup

from fieldbake.cli.application import app as command_line
from fieldbake.cli.application import load as load_commands

DOCS = Path(__file__).parents[1]
ROOT = DOCS.parent

#: Documents of the root that are pages of the site.
DOCUMENTS = ("ARCHITECTURE", "CHANGELOG", "CONTRIBUTING")


def document(name: str) -> str:
    """The text of a document of the root. Links to other documents lead to their pages; others become plain text."""
    text = (ROOT / f"{name}.md").read_text(encoding="utf-8")

    def link(match: re.Match[str]) -> str:
        words, target = match.groups()
        if target.startswith(("http:", "https:", "#")):
            return match.group()
        stem = Path(target).stem
        return f"[{words}]({stem.lower()}.md)" if stem in DOCUMENTS and "/" not in target else words

    return re.sub(r"(?<!!)\[([^\]]+)\]\(([^)\s]+)\)", link, text)


def _parameters(command: TyperCommand | TyperGroup, context: typer.Context, without: tuple[str, ...] = ()) -> list[str]:
    """Definition lists of the arguments and options of a command, except those with the names in `without`."""
    lines = []
    for parameter in command.get_params(context):
        record = parameter.get_help_record(context)
        if record is not None and parameter.name not in without:
            # The type of an argument is Python's; its name says enough.
            name = record[0].split()[0] if parameter.param_type_name == "argument" else record[0]
            lines += [f"`{name}`", f": {cell(record[1])}", ""]
    return lines


def commands() -> str:
    """A section for each command: its purpose, its arguments and its options, from the objects that parse them."""
    load_commands()  # without it the group has the names of the commands only
    group = typer.main.get_command(command_line)
    lines = [
        "# Command line",
        "",
        "`pip install` puts the program `fieldbake` beside Python. `fieldbake COMMAND --help` prints the section of a",
        "command. This page is generated from the program.",
        "",
    ]
    context = typer.Context(group, info_name="fieldbake", **group.context_settings)
    lines += ["## Options of the program", "", *_parameters(group, context)]
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        if command is None or command.hidden:
            continue
        inner = typer.Context(command, info_name=name, parent=context)
        usage = " ".join(command.collect_usage_pieces(inner))
        lines += [f"## {name}", "", "```text", f"fieldbake {name} {usage}", "```", ""]
        paragraphs = re.split(r"\n\s*\n", (command.help or "").replace("\b", "").strip())
        for paragraph in paragraphs:
            lines += [cell(paragraph), ""]
        lines += _parameters(command, inner, without=("help",))
    return "\n".join(lines)


def generate(_: Sphinx) -> None:
    """Write the generated pages; unchanged ones keep their time, so that Sphinx does not read them again."""
    folder = DOCS / "generated"
    folder.mkdir(exist_ok=True)
    pages = {name.lower(): document(name) for name in DOCUMENTS if (ROOT / f"{name}.md").exists()}
    pages["command_line"] = commands()
    pages["files"] = files()
    for name, text in pages.items():
        path = folder / f"{name}.md"
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, bool]:
    """Generate the pages before Sphinx looks for sources."""
    app.connect("builder-inited", generate)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
