"""For pages whose cells type commands (`!nontwist run ...`): `%run _extensions/terminal.py` first, in a hidden cell.

Commands run in an empty folder with examples/ in it, as in a clone; one that fails makes the page fail. They print
as into a file: no colours, no bars.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from IPython import get_ipython

ROOT = Path(__file__).parents[2]


def typed(command: str) -> None:
    """Run a command as a terminal would and print what it says."""
    done = subprocess.run(command, shell=True, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT)
    if done.returncode:
        raise SystemExit(f"{command}: exit code {done.returncode}\n{done.stdout}")
    print("\n".join(line.rstrip() for line in done.stdout.splitlines()))


folder = Path(tempfile.mkdtemp())
shutil.copytree(ROOT / "examples", folder / "examples")
os.chdir(folder)
os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
os.environ |= {"NO_COLOR": "1", "COLUMNS": "88"}
os.environ.pop("FORCE_COLOR", None)  # of the kernel; it would make progress bars of files
get_ipython().system = typed
