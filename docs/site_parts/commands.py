"""Reference of the command line: a page for each command, generated from the command's help."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import typer
from armrig.cli import app as armrig
from armrig_daemon.command_line import app as armrigd

from site_parts.pages import GENERATED, table, write_page


def commands() -> Iterator[tuple[str, Any]]:
    """Yield the name and the click object of each command; a group precedes its members."""
    for program, typed in (("armrig", armrig()), ("armrigd", armrigd)):
        yield from _below(program, typer.main.get_command(typed))


def _below(name: str, command: Any) -> Iterator[tuple[str, Any]]:
    for key, member in _members(command):
        yield f"{name} {key}", member
        yield from _below(f"{name} {key}", member)


def _members(command: Any) -> list[tuple[str, Any]]:
    """Return the visible commands of a group; an empty list for a command that is not a group."""
    found = getattr(command, "commands", {})
    names = command.list_commands(None) if found else []
    return [(name, found[name]) for name in names if not found[name].hidden]


def _first(command: Any) -> str:
    return _plain(command.help).split("\n\n")[0].replace("\n", " ")


def options(name: str, command: Any) -> Iterator[tuple[str, str, str]]:
    """Yield kind, spelling and help of each argument and option, as `-h` shows them."""
    context = typer.Context(command, info_name=name, terminal_width=1000, max_content_width=1000)
    for parameter in command.get_params(context):
        if shown := parameter.get_help_record(context):
            yield parameter.param_type_name.title(), *shown


def page(name: str, command: Any) -> str:
    """Return the page of a command: usage, description, example, arguments and options."""
    context = typer.Context(command, info_name=name, terminal_width=1000, max_content_width=1000)
    usage = command.get_usage(context).removeprefix("Usage: ")
    text = [f"# {name}", _plain(command.help), f"```text\n{usage}\n```"]
    if command.epilog:
        text.append(f"```sh\n{command.epilog.removeprefix('Example: ')}\n```")
    rows = list(options(name, command))
    for kind in ("Argument", "Option"):
        if some := [(f"`{spelling}`", _plain(said)) for k, spelling, said in rows if k == kind]:
            text.append(table((kind, "Meaning"), *some))
    file = name.replace(" ", "-")
    if below := [(f"[{name} {k}]({file}-{k}.md)", _first(c)) for k, c in _members(command)]:
        text.append(table(("Command", "Effect"), *below))
    return "\n\n".join(text) + "\n"


def _plain(text: str | None) -> str:
    """Return the text, with a backslash before each character that Markdown would interpret."""
    lines = (text or "").replace("\b\n", "")
    return "".join(f"\\{c}" if c in "<>*_[]$" else c for c in lines)


def write(folder: Path = GENERATED / "commands") -> None:
    """Write a page for each command, and a page that lists the commands."""
    listed: dict[str, list[tuple[str, str]]] = {"armrig": [], "armrigd": []}
    for name, command in commands():
        file = name.replace(" ", "-")
        write_page(folder / f"{file}.md", page(name, command))
        listed[name.split()[0]].append((f"[{name}]({file}.md)", _first(command)))
    index = [
        "# Commands",
        "`armrig` is for people who use a rig or its data. `armrigd` is the daemon.",
    ]
    for program, rows in listed.items():
        index += [f"## {program}", table(("Command", "Effect"), *rows)]
    write_page(
        folder / "index.md", "\n\n".join([*index, "```{toctree}\n:hidden:\n:glob:\n\n*\n```\n"])
    )


def setup(app: Any) -> dict[str, bool]:
    """Generate the pages before Sphinx looks for its sources."""
    app.connect("config-inited", lambda *_: write())
    return {"parallel_read_safe": True, "parallel_write_safe": True}
