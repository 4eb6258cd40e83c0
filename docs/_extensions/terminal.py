"""For pages whose cells type commands (`!nontwist run ...`): `%run _extensions/terminal.py` first, in a hidden cell.

Commands run in an empty folder with examples/ in it, as in a clone; one that fails makes the page fail. They print
as into a file: no colours, no bars. Those of this package run in the process of the page.
"""

import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from IPython import get_ipython
from typer.testing import CliRunner

from nontwist.cli import app

ROOT = Path(__file__).parents[2]


def typed(command: str) -> None:
    """Run a command as a terminal would and print what it says."""
    name, *words = shlex.split(command)
    if name == "nontwist" and not set(command) & set("|&;<>*?$"):
        done = CliRunner().invoke(app, words, prog_name="nontwist")
        status, said = done.exit_code, done.output
    else:
        done = subprocess.run(command, shell=True, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        status, said = done.returncode, done.stdout
    if status:
        raise SystemExit(f"{command}: exit status {status}\n{said}")
    print("\n".join(line.rstrip() for line in said.splitlines()))


folder = Path(tempfile.mkdtemp())
shutil.copytree(ROOT / "examples", folder / "examples")
os.chdir(folder)
os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
os.environ |= {"NO_COLOR": "1", "COLUMNS": "88"}
get_ipython().system = typed
