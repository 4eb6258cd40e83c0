"""`python -m nontwist`, the same as the command `nontwist`."""

from nontwist.cli import app

if __name__ == "__main__":
    app()
