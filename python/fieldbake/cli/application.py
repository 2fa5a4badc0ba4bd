"""The command line: the application, its common options, and the table of commands.

Exit codes: 0 for success, 1 for an error in the input (one line on stderr), 2 for wrong usage.
"""

from __future__ import annotations

import importlib
import logging
import warnings
from collections.abc import Callable
from typing import Annotated, Any, TypeVar

import typer
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from typer.core import TyperCommand, TyperGroup

import fieldbake as fb

from ..base.errors import MaterialWarning

_Function = TypeVar("_Function", bound=Callable[..., Any])


class Errors(Console):
    """Standard error; without progress bars in quiet runs."""

    silent = False

    @property
    def is_terminal(self) -> bool:
        """Whether progress is shown."""
        return super().is_terminal and not self.silent


class Clobber:
    """Whether outputs may replace files that exist."""

    allowed = True


out = Console(highlight=False)
err = Errors(stderr=True, highlight=False)

#: The module of each command, and the text that the list of commands shows: the first paragraph of its docstring.
COMMANDS = {
    "bake": (
        "commands",
        "Bake the signed distance field of a mesh into a file, or the fields of many meshes into a folder.",
    ),
    "info": ("files", "Describe the contents of files."),
    "check": (
        "queries",
        "Report whether meshes are closed, oriented and free of self-intersections, and how thin they are.",
    ),
    "query": ("queries", "Write signed distance, gradient, closest point, face and weights of every point."),
    "sample": (
        "libraries",
        "Write training samples of many meshes: points, and the signed distances and gradients there.",
    ),
    "pack": ("commands", "Pack baked fields and meshes into a texture atlas."),
    "render": (
        "pictures",
        "Draw scenes: glTF or any mesh files with their textures, cameras and lights, or baked fields.",
    ),
    "view": ("view", "Write a live view of each file as one HTML page, and open it."),
    "csg": (
        "pictures",
        "Draw, bake or mesh a shape from a file with its s-expression. The z axis points upwards in pictures.",
    ),
    "merge": ("commands", "Merge all instances of a scene into one field whose samples never exceed the distance."),
    "mesh": ("solids", "Write the surface of a field, a shape or a mesh as a closed mesh."),
    "solid": ("solids", "Write a closed two-manifold mesh made from any triangles."),
    "boolean": ("solids", "Combine two meshes: fieldbake boolean a.stl - b.stl -o c.stl."),
    "slice": ("layers", "Slice a solid into layers for a printer: images in a .zip archive, or outlines as .svg."),
    "cook": (
        "physics",
        "Write collision fields with exact distances, for MuJoCo from a robot or for Newton from meshes.",
    ),
    "sweep": ("physics", "Write the space that a moving part or robot covers, as a closed mesh or a field."),
    "convert": (
        "files",
        "Write a field, an atlas or a mesh in another format; a field becomes a mesh as its zero surface.",
    ),
    "demo": ("pictures", "Bake, save, load and draw meshes; write pictures and print the steps."),
    "devices": ("pictures", "List the compute devices."),
    "doctor": (
        "doctor",
        "Print versions, devices and packages, and test what works here. Exit status 1 means that a test failed.",
    ),
}

#: Commands that show or keep materials. The others need the positions of a mesh only.
WITH_MATERIALS = ("convert", "demo", "render", "view")

#: Options of every command, which may come before or after its name.
COMMON = ("-q", "--quiet", "--no-clobber")


class Group(TyperGroup):
    """The group of all commands, each of which is imported when it is called.

    Errors in the input are printed as one line, with exit code 1; other exceptions keep their traceback.
    """

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        listed = {name: TyperCommand(name=name, help=text) for name, (_, text) in COMMANDS.items()}
        # Commands of modules that are imported are complete; the others only have their help in the list.
        self.commands = {**listed, **self.commands}

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Import the module of a command before it is called or completed."""
        if args and args[0] in COMMANDS:
            load(args[0])
            self.commands.update(typer.main.get_command(app).commands)  # type: ignore[attr-defined]
        return super().resolve_command(ctx, args)

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Move the options that all commands share to the front."""
        end = args.index("--") if "--" in args else len(args)
        common = [arg for arg in args[:end] if arg in COMMON]
        rest = [arg for arg in args[:end] if arg not in COMMON] + args[end:]
        return list(super().parse_args(ctx, common + rest))

    def invoke(self, ctx: Any) -> Any:
        """Run a command; see the description of the class."""
        try:
            return super().invoke(ctx)
        except BrokenPipeError:
            raise  # the program that read the output has ended; Typer then exits without a message
        except (fb.Error, OSError) as error:
            text = str(error)
            if isinstance(error, OSError) and error.strerror:
                text = f"{error.filename}: {error.strerror}" if error.filename else error.strerror
            err.print(f"[bold red]error:[/] {escape(text)}", soft_wrap=True)
            raise typer.Exit(1) from None


class Command(TyperCommand):
    """A command whose help names arguments plainly: ``MESH...`` instead of ``{MESH}...`` and ``<list[Path]>``."""

    def get_params(self, ctx: Any) -> list[Any]:
        """Return the parameters; arguments without the Python type that some versions of Typer print."""
        parameters: list[Any] = list(super().get_params(ctx))
        for parameter in parameters:
            if parameter.param_type_name == "argument":
                parameter.metavar = (parameter.metavar or parameter.name or "").upper()
                parameter.display_type_rich = lambda ctx: None  # noqa: ARG005 - the signature is Typer's
        return parameters

    def collect_usage_pieces(self, ctx: Any) -> list[str]:
        """Return the words of the usage line."""
        return [piece.replace("{", "").replace("}", "") for piece in super().collect_usage_pieces(ctx)]


class Application(typer.Typer):
    """An application whose commands are of the class :class:`Command`."""

    def command(self, name: str | None = None, **options: Any) -> Callable[[_Function], _Function]:
        """Return a decorator that adds a command."""
        return super().command(name, **{"cls": Command, **options})


app = Application(
    cls=Group,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    context_settings={"help_option_names": ["-h", "--help"]},
    help="Exact signed distance fields from triangle meshes and CSG shapes.",
)


def _version(is_requested: bool) -> None:
    if is_requested:
        typer.echo(f"fieldbake {fb.__version__}")
        raise typer.Exit


@app.callback()
def root(
    context: typer.Context,
    version: Annotated[  # noqa: ARG001 - its callback has done the work
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version and exit.")
    ] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Print errors only. May follow the name of a command.")
    ] = False,
    no_clobber: Annotated[
        bool, typer.Option("--no-clobber", help="Do not replace existing files. May follow the name of a command.")
    ] = False,
) -> None:
    """Options of every command."""
    if context.invoked_subcommand not in WITH_MATERIALS:
        warnings.simplefilter("ignore", MaterialWarning)
    out.quiet = err.silent = quiet
    if logging.lastResort is not None:
        # Messages of libraries such as trimesh have no other handler.
        logging.lastResort.setLevel(logging.ERROR if quiet else logging.WARNING)
    Clobber.allowed = not no_clobber


def load(*names: str) -> None:
    """Import the modules of the named commands, by default of all; each import adds its commands to `app`."""
    for name in names or COMMANDS:
        importlib.import_module(f".{COMMANDS[name][0]}", __package__)


def show_rows(title: str, rows: list[tuple[str, str]]) -> None:
    """Print labels and texts as a table."""
    table = Table(title=escape(title), title_justify="left", show_header=False, title_style="bold")
    table.add_column(style="cyan", no_wrap=True)
    table.add_column(overflow="fold")
    for label, text in rows:
        table.add_row(label, escape(text), style="yellow" if label == "warning" else None)
    out.print(table)


def show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    """Print a warning as one line, without the line of the source; nothing in quiet runs."""
    if not err.silent:
        err.print(f"[yellow]warning:[/] {escape(str(message))}", soft_wrap=True)


def main() -> None:
    """Run the command line."""
    # The tables and summaries that commands print have the warnings about surfaces.
    warnings.simplefilter("ignore", fb.SurfaceWarning)
    warnings.showwarning = show_warning
    app(prog_name="fieldbake")
