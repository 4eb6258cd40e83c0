"""How help is laid out: plain text, in lines that are broken between words only, never within a name or an option.

And how a value is refused that an option cannot take: Typer hands on the words of pydantic, which say neither what was
given nor what would do.
"""

from __future__ import annotations

from typing import Any

from typer import BadParameter
from typer.core import TyperCommand

HYPHEN = "\N{NON-BREAKING HYPHEN}"  # stands for the hyphen while lines are broken
COMMON = "--import"  # the option of all commands, which the program reads
NARROW = 70  # columns; below them only short names stand beside what they mean


def whole(text: str) -> str:
    """Return a text in which no line is broken at a hyphen, and none between an option and its value."""
    return text.replace("-", HYPHEN)


def place(parameter: Any) -> str:
    """Return how an argument or an option is written: ``FILE...``, ``-q, --quiet``, ``--out PATH``.

    Short names are first: Typer hands on those of help in the order of a set, another one in each process.
    """
    value = parameter.metavar or ""
    if parameter.param_type_name == "argument":
        return value if parameter.required or value.startswith("[") else f"[{value}]"
    names = ", ".join([*sorted(parameter.opts, key=len), *parameter.secondary_opts])
    return f"{names} {value}".rstrip() if not parameter.is_flag else names


def meaning(parameter: Any) -> str:
    """Return what an argument or an option means, and what it is where it is left out."""
    text, default = parameter.help or "", parameter.show_default
    if not isinstance(default, str):
        value = getattr(parameter.default, "value", parameter.default)
        default = "" if not default or value is None or isinstance(value, bool) else str(value)
    return f"{text} Default: {default}." if default else text


def refusal(error: Any) -> str:
    """Return what is wrong with the value of an option, of an error of pydantic."""
    found = error.errors(include_url=False)[0]
    given, limits = found["input"], found.get("ctx", {})
    match found["type"]:
        case "int_parsing" | "int_from_float" | "int_type":
            return f"{given} is not a whole number"
        case "float_parsing" | "float_type":
            return f"{given} is not a number"
        case "greater_than_equal":
            return f"{given} is below {limits['ge']:g}, the smallest value"
        case "less_than_equal":
            return f"{given} is above {limits['le']:g}, the largest value"
        case "value_error":
            return str(limits["error"])
        case _:
            return f"{given} is not {found['msg'].removeprefix('Input should be ')}"


class Command(TyperCommand):
    """A command of `nontwist`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the arguments of a command line; a value that is refused is shown."""
        try:
            return super().parse_args(ctx, args)
        except BadParameter as error:
            if (cause := error.__cause__) is not None and hasattr(cause, "errors"):
                error.message = refusal(cause)
            raise

    def format_usage(self, ctx: Any, formatter: Any) -> None:
        """Write how the command is called."""
        places = [place(one) + "..." * (one.nargs == -1) for one in self.params if one.param_type_name == "argument"]
        formatter.write_usage(ctx.command_path, " ".join(["[OPTIONS]", *places]))

    def format_help_text(self, ctx: Any, formatter: Any) -> None:
        """Write what the command does, paragraph by paragraph."""
        with formatter.indentation():
            for paragraph in (self.help or "").split("\n\n"):
                formatter.write_paragraph()
                formatter.write_text(whole(paragraph))

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the arguments and the options, that of all commands last."""
        params: list[Any] = [*self.get_params(ctx), *(one for one in ctx.parent.command.params if COMMON in one.opts)]
        for title, kind in (("Arguments", "argument"), ("Options", "option")):
            shown = [one for one in params if one.param_type_name == kind and not one.hidden]
            rows = [(whole(place(one)), whole(meaning(one))) for one in shown]
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows, col_max=18 if formatter.width < NARROW else 30)

    def get_help(self, ctx: Any) -> str:
        """Return the help, with its hyphens."""
        return str(super().get_help(ctx)).replace(HYPHEN, "-")
