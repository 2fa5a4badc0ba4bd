"""The command line starts quickly: each command is imported when it is called."""

import inspect
import os
import subprocess
import sys

import pytest
import typer.main
from typer.testing import CliRunner

from fieldbake.cli import application

#: Modules that are slow to import and that neither `--version` nor `--help` needs.
SLOW = {"numpy", "trimesh", "PIL", "fieldbake.volumes"}


@pytest.mark.parametrize("argument", ["--version", "--help"])
def test_version_and_help_import_no_command(argument):
    script = """
import sys
from fieldbake.cli import main
try:
    main()
finally:
    print(*sys.modules, file=sys.stderr)
"""
    result = subprocess.run(
        [sys.executable, "-c", script, argument], capture_output=True, text=True, check=True, timeout=60
    )
    imported = set(result.stderr.split())

    assert "fieldbake" in result.stdout
    assert "fieldbake.cli.application" in imported
    assert imported & SLOW == set()


def test_the_list_of_commands_has_the_names_and_the_help_of_the_commands():
    application.load()
    commands = {info.name or info.callback.__name__: info.callback for info in application.app.registered_commands}

    assert set(commands) == set(application.COMMANDS)
    for name, (module, text) in application.COMMANDS.items():
        assert commands[name].__module__ == f"fieldbake.cli.{module}"
        assert " ".join(inspect.getdoc(commands[name]).partition("\n\n")[0].split()) == text


def test_every_command_is_called_with_its_own_options():
    for name in application.COMMANDS:
        result = CliRunner().invoke(application.app, [name, "--help"], prog_name="fieldbake")

        assert result.exit_code == 0
        assert f"fieldbake {name} [OPTIONS]" in result.stdout


def test_an_unknown_command_is_an_error_with_a_suggestion():
    result = CliRunner().invoke(application.app, ["bakee"], prog_name="fieldbake")

    assert result.exit_code == 2
    assert "bake" in result.stderr


def test_completion_knows_the_options_of_a_command_that_is_not_imported():
    words = {"_FIELDBAKE_COMPLETE": "complete_bash", "COMP_WORDS": "fieldbake merge --res", "COMP_CWORD": "2"}
    result = subprocess.run(
        [sys.executable, "-m", "fieldbake"],
        env={**os.environ, **words},
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )

    assert result.stdout.split() == ["--resolution"]


def test_the_application_has_complete_commands_once_they_are_imported():
    application.load("merge")

    merge = typer.main.get_command(application.app).commands["merge"]

    assert {"scene", "output", "resolution", "device"} <= {parameter.name for parameter in merge.params}
