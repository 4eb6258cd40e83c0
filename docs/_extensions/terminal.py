"""For pages whose cells type commands (`!nontwist run ...`): `%run _extensions/terminal.py` first, in a hidden cell.

Commands run in an empty folder with examples/ in it, as in a clone; one that fails makes the page fail. They print
as into a file: no colours, no bars. Those of this package run one after another in a process that has imported it.
"""

import json
import os
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from IPython import get_ipython

ROOT = Path(__file__).parents[2]


def typed(command: str) -> None:
    """Run a command as a terminal would and print what it says."""
    name, *words = shlex.split(command)
    if name == "nontwist" and not set(command) & set("|&;<>*?$"):
        print(json.dumps(words), file=SERVER.stdin, flush=True)
        status, said = json.loads(SERVER.stdout.readline())
    else:
        done = subprocess.run(command, shell=True, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
        status, said = done.returncode, done.stdout
    if status:
        raise SystemExit(f"{command}: exit status {status}\n{said}")
    print("\n".join(line.rstrip() for line in said.splitlines()))


SERVED = """
import json, signal, sys
from typer.testing import CliRunner
from nontwist.cli import app
signal.signal(signal.SIGINT, signal.SIG_IGN)  # it ends with the page
for line in sys.stdin:
    result = CliRunner().invoke(app, json.loads(line), prog_name="nontwist")
    print(json.dumps([result.exit_code, result.output]), flush=True)
"""
folder = Path(tempfile.mkdtemp())
shutil.copytree(ROOT / "examples", folder / "examples")
os.chdir(folder)
os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
os.environ |= {"NO_COLOR": "1", "COLUMNS": "88"}
os.environ.pop("FORCE_COLOR", None)  # of the kernel; it would make progress bars of files
SERVER = subprocess.Popen([sys.executable, "-c", SERVED], text=True, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
get_ipython().system = typed
