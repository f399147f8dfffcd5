"""Inverse dynamics of chapter 7: the paper's networks and their peers, beside its own tables."""

from __future__ import annotations

import argparse
from typing import Final

from reproduction.modelling.arguments import declare
from reproduction.modelling.grid_command import examples, execute

EXAMPLES: Final = examples("id")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    declare(parser, "id")


def run(args: argparse.Namespace) -> int:
    """Train what is missing, show, and write where asked for.

    :param args: see :func:`add_arguments`
    :return: exit status
    """
    return execute(args, "id")
