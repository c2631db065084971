"""The directive `{commands}`: the help of every command, made of the command line itself."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, get_args

import typer
from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from splitband.cli import app as command_line

KINDS = {int: "N", float: "NUMBER", Path: "PATH"}
"""What an option of a type takes, where it does not say so itself."""


class Commands(SphinxDirective):
    """A list of all commands, and a section with the help of each."""

    def run(self) -> list[nodes.Node]:
        """Usage, explanation, and a list of options in the groups of `--help`."""
        group: Any = typer.main.get_command(command_line)
        listed = nodes.definition_list()
        sections: list[nodes.Node] = []
        for name in group.list_commands(None):
            command = group.get_command(None, name)
            line = " ".join((command.help or "").partition("\n\n")[0].split())
            listed += _defined([nodes.literal("", f"splitband {name}")], self.parse_inline(line)[0])
            sections.append(self._section(f"splitband {name}", command))
        return [listed, nodes.paragraph("", "For all of them:"), *self._options(group), *sections]

    def _section(self, name: str, command: Any) -> nodes.Node:
        section = nodes.section(ids=[name.replace(" ", "-")])
        section += nodes.title("", name)
        section += [*self._described(name, command)]
        return section

    def _described(self, name: str, command: Any) -> Iterator[nodes.Node]:
        arguments = [p for p in command.params if p.param_type_name == "argument"]
        words = [name, *(f"{{{_name(p)}}}" for p in arguments), "[OPTIONS]"]
        yield nodes.literal_block("", " ".join(words), language="text")
        for paragraph in (command.help or "").split("\n\n"):
            yield nodes.paragraph("", "", *self.parse_inline(" ".join(paragraph.split()))[0])
        yield from self._options(command)
        for word, sub in getattr(command, "commands", {}).items():
            yield self._section(f"{name} {word}", sub)

    def _options(self, command: Any) -> Iterator[nodes.Node]:
        panels: dict[str, list[Any]] = {}
        for parameter in command.params:
            if not getattr(parameter, "hidden", False):
                panel = getattr(parameter, "rich_help_panel", None) or ""
                panels.setdefault(panel, []).append(parameter)
        for title, members in panels.items():
            if title:
                yield nodes.rubric("", title)
            listed = nodes.definition_list()
            for each in members:
                listed += self._option(each)
            yield listed

    def _option(self, parameter: Any) -> nodes.Node:
        """An option or argument: how it is written, what it does, what it is by default."""
        named = _name(parameter)
        if parameter.param_type_name == "option":
            names = ", ".join([*parameter.opts, *parameter.secondary_opts])
            value = parameter.metavar or _kind(parameter.type_descriptor.annotation)
            named = names if parameter.is_flag else f"{names} {value}"
        said = [parameter.help or ""]
        default = parameter.show_default
        if default is True:
            default = parameter.default
        if default not in (None, "") and not isinstance(default, bool):
            said.append(f"Default: {default}.")
        if parameter.required:
            said.append("Must be given.")
        text = self.parse_inline(" ".join(" ".join(said).split()).replace("*", r"\*"))[0]
        return _defined([nodes.literal("", named)], text)


def _name(argument: Any) -> str:
    return str(argument.metavar or argument.name.upper())


def _kind(of: Any) -> str:
    """What an option takes, in a word."""
    values = get_args(of)
    return "|".join(map(str, values)) if values else KINDS.get(of, "TEXT")


def _defined(term: list[nodes.Node], text: list[nodes.Node]) -> nodes.Node:
    said = nodes.definition("", nodes.paragraph("", "", *text))
    return nodes.definition_list_item("", nodes.term("", "", *term), said)


def setup(app: Sphinx) -> dict[str, bool]:
    """Add the directive to Sphinx."""
    app.add_directive("commands", Commands)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
