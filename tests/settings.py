"""`make test-settings`: the quick suite in the settings that users have.

All settings run `make test` in one copy of the checkout and its environment, in a folder of mode 0700. Arguments name
the settings to run, all by default. Logs go to build/settings/.
"""

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[1]
LOGS = ROOT / "build" / "settings"
LEFT_OUT = {"build", "dist", "reproduction", ".hypothesis", ".pytest_cache"}  # of the checkout; not inside .venv
NOBODY = {"user": 65534, "group": 65534, "extra_groups": []}
BUSY = "import os\nparent = os.getppid()\nwhile os.getppid() == parent: pass"


class Setting(NamedTuple):
    """What is different from a terminal on an idle machine."""

    words: str
    prepare: Callable[[], object] | None = None  # called in the child
    environment: dict[str, str | None] = {}  # noqa: RUF012 - None takes a variable away
    busy_loops: int = 0
    as_nobody: bool = False


def in_the_background():
    for number in (signal.SIGINT, signal.SIGQUIT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)


HOMELESS = dict.fromkeys(("HOME", "XDG_CACHE_HOME", "XDG_CONFIG_HOME", "USER", "LOGNAME"))
ASCII = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0", "TZ": "Asia/Kathmandu"}
SETTINGS = {
    "plain": Setting("checkout in a folder of mode 0700"),
    "one-core": Setting("one core", lambda: os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})),
    "loaded": Setting("`nice`, beside two busy loops", lambda: os.nice(2), busy_loops=2),
    "background": Setting("in the background of a shell: SIGINT, SIGQUIT, SIGHUP ignored", in_the_background),
    "locale": Setting("`LC_ALL=C`, no UTF-8 mode, `TZ=Asia/Kathmandu`", environment=ASCII),
    "no-home": Setting("no `HOME`, no XDG folders", environment=HOMELESS),
    "nobody": Setting(
        "the user nobody, with a `HOME` that does not exist",
        environment={"HOME": "/nonexistent", "XDG_CACHE_HOME": None},
        as_nobody=True,
    ),
}


def main(names):
    """Run the settings, all or those named, and return how many have failed."""
    if unknown := set(names) - set(SETTINGS):
        raise SystemExit(f"unknown settings: {', '.join(unknown)}; known are {', '.join(SETTINGS)}")
    shutil.rmtree(LOGS, ignore_errors=True)
    LOGS.mkdir(parents=True)
    failed = 0
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "nontwist"
        shutil.copytree(
            ROOT, place, symlinks=True, ignore=lambda at, all: LEFT_OUT & {*all} if Path(at) == ROOT else ()
        )
        for name in names or SETTINGS:
            print(f"{name}: {SETTINGS[name].words}", flush=True)
            begin = time.monotonic()
            code, words = run(place, name, SETTINGS[name])
            print(f"  {words}, {(time.monotonic() - begin) / 60:.1f} min", flush=True)
            failed += bool(code)
    return failed


def run(place, name, setting):
    """Return the exit status of the suite in a setting, and what it says in its last line."""
    if setting.as_nobody and (os.geteuid() != 0 or not python_for_all(place / ".venv")):
        return 0, "skipped: only root may run as another user, who may run this Python"
    variables = {**os.environ, "PYTHONPATH": str(place / "src"), **setting.environment}
    known = {key: value for key, value in variables.items() if value is not None}
    log = LOGS / f"{name}.log"
    with ExitStack() as stack:
        if setting.as_nobody:
            place.parent.chmod(0o755)
            subprocess.run(["chown", "-R", f"{NOBODY['user']}:{NOBODY['group']}", place], check=True)
        for _ in range(setting.busy_loops):
            loop = stack.enter_context(subprocess.Popen([sys.executable, "-c", BUSY]))
            stack.callback(loop.kill)
        how = {"cwd": place, "env": known, "stdin": subprocess.DEVNULL, "stderr": subprocess.STDOUT, "check": False}
        how |= {"stdout": stack.enter_context(log.open("wb")), "preexec_fn": setting.prepare}
        done = subprocess.run(["make", "test"], **how, **(NOBODY if setting.as_nobody else {}))
    last = re.findall(rb"^=*\s*((?:\d+ \w+,? ?)+) in .*$", log.read_bytes(), re.MULTILINE)
    return done.returncode, last[-1].decode() if last else f"no result, exit status {done.returncode}; see {log}"


def python_for_all(environment):
    """Have the copied environment use a Python of its version that every user may run; return whether there is one."""
    name = f"python{sys.version_info.major}.{sys.version_info.minor}"
    for python in (Path(sys.base_prefix, "bin", name), Path("/usr/local/bin", name), Path("/usr/bin", name)):
        try:
            subprocess.run([python, "-c", ""], **NOBODY, check=True)
        except OSError:
            continue
        for link in environment.glob("bin/python*"):
            link.unlink()
            link.symlink_to(python)
        described = environment / "pyvenv.cfg"
        text = re.sub("(?m)^home = .*$", f"home = {python.parent}", described.read_text(encoding="utf-8"))
        described.write_text(text, encoding="utf-8")
        return True
    return False


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
