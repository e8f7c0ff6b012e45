"""The command line. Exit status: 0 done; 1 not solved or interrupted; 2 invalid input or usage."""

from opfmodel.cli.app import app, main

__all__ = ["app", "main"]
