"""`run`, `check`, `precision`, `example`, `schema`: what they print and where, what they write, how they end."""

import json
import os
import re
import shlex
import signal
import subprocess
import sys
from itertools import cycle, product
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import nontwist as package
from conftest import ended, nontwist
from nontwist import Problem, join_runs, open_run, plot, simulate
from nontwist.cli import app
from nontwist.cli.outcomes import code_of
from nontwist.cli.run_commands import example_names
from nontwist.errors import RunFileError, Status
from nontwist.integrators import INTEGRATORS
from nontwist.loads import Load
from nontwist.runfile import read_run_file
from refusals import said, says

BODY = '[body]\nkind = "standard"\ninertia = [1, 2, 2.5]\n'
TIME = "[time]\nt_end = 1\nstep = 0.1\n"
START = "[start]\nangular_velocity = { body = [0.3, 0.2, 0.1] }\n"
PUSHED = f'{BODY}{TIME}[[load]]\nkind = "constant"\nframe = "body"\nmoment = [100, 0, 0]\n'  # 3 rad a step after 0.3 s


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty folder to work in, with files to be written."""
    monkeypatch.chdir(tmp_path)
    return lambda text=BODY + TIME, name="run.toml": Path(name).write_text(text, encoding="utf-8")


def files():
    return sorted(str(path) for path in Path().rglob("*") if path.is_file())


def told(*arguments, **environment):
    """Return the exit status of a command, and what it prints on both streams."""
    result = nontwist(*arguments, **environment)
    return result.exit_code, result.stdout, result.stderr


def numbers_of(*arguments):
    result = nontwist(*arguments, "--json")
    assert result.stdout, result.stderr
    return json.loads(result.stdout)


def has(text, *words):
    assert [one for one in words if one not in text] == [], text


@pytest.mark.usefixtures("undrawn")  # figures are drawn in test_paths_of_results
def test_the_first_five_minutes(here):
    listed = ended(0, "example")
    has(listed.stdout, *example_names())
    assert listed.stderr == "next: nontwist example NAME\n"
    said(ended(0, "example", "heavy_top").stderr)
    text = Path("heavy_top.toml").read_text(encoding="utf-8").replace("t_end = 4.0", "t_end = 0.1")
    here(text, "heavy_top.toml")
    checked = ended(0, "check", "heavy_top.toml")
    assert (checked.stderr, files()) == ("next: nontwist run heavy_top.toml\n", ["heavy_top.toml"])
    has(
        checked.stdout,
        "heavy_top.toml is valid",
        "gauss, order 8",
        "200 of 0.0005 s",
        "at most 3.",
        "21 states, about ",
    )
    has(checked.stdout, "° at the end, for a steady rotation", "without start-up", "loads         │ none")
    run = ended(0, "run", "heavy_top.toml", "--figures")
    has(
        run.stdout,
        "Heavy top",
        "200 of 0.0005 s",
        "total energy",
        "vertical momentum",
        "time taken",
        " s, with start-up",
    )
    assert re.search(r"│ Newton iterations +│ at most \d+ per step", run.stdout)
    figures = [f"heavy_top-{name}{end}" for name in ("energy", "momenta", "path") for end in (".pdf", ".png")]
    assert files() == sorted([*figures, "heavy_top.nc", "heavy_top.toml"])
    assert run.stderr.startswith("written: heavy_top.nc, heavy_top-momenta.pdf, ")
    assert "Heavy top" in ended(0, "info", "heavy_top.nc").stdout
    assert open_run("heavy_top.nc").sizes["time"] == 21


@pytest.mark.usefixtures("undrawn")
def test_time_of_figures(here, monkeypatch):
    here(BODY + TIME + START)
    now = [0.0]

    def lasting(seconds, function):
        def call(*given, **keywords):
            now[0] += seconds
            return function(*given, **keywords)

        return call

    monkeypatch.setattr("nontwist.cli.run_commands.perf_counter", lambda: now[0])
    monkeypatch.setattr(package, "simulate", lasting(2.0, simulate))
    monkeypatch.setattr(package.plot, "save", lasting(3.0, package.plot.save))
    drawn = ["--set", 'output.figures=["energy", "path"]', "--force"]
    found = numbers_of("run", "run.toml", *drawn)
    assert (found["seconds"], found["figure_seconds"]) == (2.0, 6.0)
    assert "│ 2 s, with start-up, and 6 s for figures" in ended(0, "run", "run.toml", *drawn).stdout
    assert "2 s, with start-up  " in ended(0, "run", "run.toml", "--force").stdout


def test_json_numbers_equal_simulate(here):
    here(BODY + TIME + START)
    found = numbers_of("run", "run.toml", "--set", "title='[\"été\"]'")
    run, problem = open_run("run.nc"), Problem.read("run.toml")
    assert np.array_equal(run.directors, simulate(problem).directors)
    derived = package.sensitivities(problem, wrt="material_angular_velocity")  # takes the arguments of a file too
    assert np.array_equal(run.directors, derived.directors)
    assert found.pop("seconds") > 0
    drift = found.pop("drift")
    assert set(drift) == {"kinetic_energy", "spatial_momentum", "orthonormality"}
    assert max(one["relative"] for one in drift.values()) < 1e-14
    assert found.pop("newton_iterations") == int(run.newton_iterations.max()) > 0
    names = {"file": "run.toml", "result": "run.nc", "written": ["run.nc"], "title": '["été"]'}
    times = {"steps": 10, "step": 0.1, "t_start": 0.0, "t_end": 1.0, "states": 11}
    scheme = {"name": "gauss", "order": 8}
    assert found == names | times | {"status": 0, "message": "done", "integrator": scheme}


def test_quiet_prints_warnings_only(here):
    here()
    coarse = ["--set", "start.angular_velocity={ body = [17, 0, 0] }", "--set", 'integrator.name="lie-midpoint"']
    for command in ("check", "run"):
        loud = nontwist(command, "run.toml", *coarse).stderr.splitlines(keepends=True)
        (warned,) = (line for line in loud if line.startswith("run.toml: warning: the step is"))
        for options, errors in ((coarse, warned), ([], "")):
            Path("run.nc").unlink(missing_ok=True)
            assert told(command, "run.toml", "--quiet", *options) == (0, "", errors)


@pytest.mark.usefixtures("undrawn")
def test_states_of_figures(here, monkeypatch):
    """Twelve steps of 50 degrees, and curves of a hundred states; of fine steps those of the run."""
    drawn = []
    monkeypatch.setattr(plot, "path", lambda run: drawn.append(run) or plot.new_axes()[0])
    tolerance = BODY + "[time]\nt_end = 5\ntolerance = 1e-6\n[start]\nangular_velocity = { body = [0.1, 2, 0.1] }\n"
    here(tolerance + '[output]\nfigures = ["path"]\n')
    ended(0, "run", "run.toml", "--quiet")
    states, run = open_run("run.nc"), drawn[0]
    assert states.sizes["time"] < 40 < 100 < run.sizes["time"]
    assert run.sel(time=states.time).directors.values == pytest.approx(states.directors.values, abs=1e-12)
    assert run.kinetic_energy.values == pytest.approx(states.kinetic_energy.values[0], rel=1e-12)
    ended(0, "run", "run.toml", "--force", "--quiet", "--set", "time.step=0.01")
    assert drawn[1].sizes["time"] == open_run("run.nc").sizes["time"] == 501


def test_step_and_tolerance_exclude(here):
    """On the command line, where a key of the file cannot be left out otherwise; KEY= removes any."""
    here(BODY + "[time]\nt_end = 1\ntolerance = 1e-6\n")
    for options, step, tolerance in (
        (["time.step=0.1"], 0.1, None),
        (["time.tolerance="], None, None),
        (["time.tolerance=", "time.step=0.5"], 0.5, None),
        (["time.step="], None, 1e-6),
        (["time.tolerance=1e-3"], None, 1e-3),
    ):
        time = read_run_file("run.toml", options).time
        assert (time.step, time.tolerance) == (step, tolerance)
    with says(RunFileError):
        read_run_file("run.toml", ["time.step=0.1", "time.tolerance=1e-3"])
    has(nontwist("check", "run.toml").stdout, "1e-06 rad; order and steps are a first estimate", " s (automatic), t = ")
    here()
    assert read_run_file("run.toml", ["time.tolerance=1e-3"]).time.step is None
    target = nontwist("precision", "run.toml", "--target", "1e-6", "--set", "body.kind=")
    assert target.stderr.startswith("run.toml: body.kind: missing -> ")


def test_tolerance_of_too_many_steps(here):
    start = START.replace("0.3, 0.2", "30, 20")
    here(BODY + start + "[time]\nt_end = 1\ntolerance = 1e-20\n[integrator]\nname = 'lie-midpoint'\n")
    said(re.sub(r"\de\+\d\d", "N", nontwist("check", "run.toml").stderr))
    ended(0, "precision", "run.toml", "--target", "1e-3")


def test_paths_of_results(here):
    own = os.fsdecode("own name é".encode())
    here()
    Path("sub").mkdir()
    here(f'{BODY}{TIME}[output]\npath = "own.nc"\nfigures = ["energy"]\n', f"sub/{own}.toml")
    ended(0, "run", "run.toml", f"sub/{own}.toml")
    ended(0, "run", "run.toml", "--out", "a.nc")
    ended(0, "run", "run.toml", f"sub/{own}.toml", "--out", "new/folder")
    figures = [f"{place}-energy{end}" for place in ("sub/own", f"new/folder/{own}") for end in (".pdf", ".png")]
    results = ["run.nc", "a.nc", "sub/own.nc", "new/folder/run.nc", f"new/folder/{own}.nc"]
    assert files() == sorted(["run.toml", f"sub/{own}.toml", *results, *figures])


def test_failed_run_keeps_its_states(here):
    here(PUSHED, "pushed.toml")
    here()
    result, kept = ended(4, "run", "pushed.toml", "run.toml", "--json"), open_run("pushed.nc")
    end = float(kept.time[-1])
    assert 0 < end < 1
    assert kept.attrs["status"] == Status.TURN
    assert 'kind = "constant"' in kept.attrs["run_file"]
    first, *others = result.stderr.splitlines()[-4:-1]
    assert re.fullmatch(r"pushed\.toml: step \d at t = 0\.\d s: the body turns .* in one step; try step <= .*", first)
    assert others == [
        f"pushed.toml: the completed part, up to t = {end:.12g} s, is saved in pushed.nc",
        "written: pushed.nc; next: nontwist view pushed.nc, nontwist info pushed.nc",
    ]
    failed, done = map(json.loads, result.stdout.splitlines())
    assert (failed["status"], done["status"], failed["message"]) == (1, 0, kept.attrs["message"])
    assert open_run("run.nc").sizes["time"] == 11
    fast = ["--force", "--set", "start.angular_velocity={ body = [0, 0, 99] }"]
    assert "the completed part, up to t = 0 s, is saved in run.nc" in ended(4, "run", "run.toml", *fast).stderr
    assert open_run("run.nc").sizes["time"] == 1


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_interrupted_run_keeps_its_states(number, here, monkeypatch, request):
    """The signal comes where the loads of the second half are sampled, block by block."""
    usual = signal.default_int_handler if number == signal.SIGINT else signal.SIG_DFL
    before = signal.signal(number, usual)  # jobs in the background of a shell, or under nohup, ignore it
    request.addfinalizer(lambda: signal.signal(number, before))
    shaken = '[[load]]\nkind = "sine"\nframe = "space"\namplitude = [1, 0, 0]\nfrequency = 1\n'
    here(BODY + TIME.replace("0.1", "1e-5\nstore = 10") + shaken)
    here(name="second.toml")
    sample = Load.sample

    def signalled(self, times, kind):
        if times[0] > 0.5:
            os.kill(os.getpid(), number)
        return sample(self, times, kind)

    monkeypatch.setattr(Load, "sample", signalled)
    result, kept = ended(130, "run", "run.toml", "second.toml"), open_run("run.nc")
    end, by = float(kept.time[-1]), "" if number == signal.SIGINT else f" ({number.name})"
    assert 0.2 < end < 1
    assert kept.attrs["status"] == Status.INTERRUPTED
    assert f"run.toml: interrupted{by} at t = {end:.12g} s, after " in result.stderr
    assert f"run.toml: the completed part, up to t = {end:.12g} s, is saved in run.nc" in result.stderr
    assert files() == ["run.nc", "run.toml", "second.toml"]


def test_check_as_json(here):
    here()
    here(f"{BODY}mass = -1\n{TIME}", "bad.toml")
    good, bad = map(json.loads, ended(3, "check", "run.toml", "bad.toml", "--json").stdout.splitlines())
    assert (good["problems"], good["forecast"]["steps"], bad["forecast"]) == ([], 10, None)
    assert bad["problems"][0] == {"key": "body.mass", "given": "-1", "accepted": "a positive number, kg"}


SECOND_QUOTIENTS = [3.987879, 3.985380, 3.984407, 3.983256, 3.981796]  # case 2, solved to round-off


def test_precision_second_quotients(here):
    nontwist("example", "case2")
    found, shown = numbers_of("precision", "case2.toml"), ended(0, "precision", "case2.toml").stdout
    assert found["second_quotients"] == pytest.approx(SECOND_QUOTIENTS, abs=2e-6)
    assert found["times"] == pytest.approx([1, 2, 3, 4, 5])
    assert found["agrees"]
    last = f"error of the attitude at the end with step h: about {found['error_at_end']:.1e} rad"
    has(shown, "steps h = 0.005 s, h/2, h/4", "3.987879", "observed order 1.995 (median), expected 2: PASS", last)
    assert files() == ["case2.toml"]
    nontwist("example", "case1")
    lag = 200 * abs(2 * np.arctan(0.005 * np.sqrt(360) / 2) - 0.005 * np.sqrt(360))
    error = numbers_of("precision", "case1.toml", "--set", "time.t_end=1.0")["error_at_end"]
    assert error == pytest.approx(lag, rel=1e-2)


def test_precision_of_unseen_orders(here):
    here(f'{BODY}{START}{TIME}[[load]]\nkind = "pulse"\nframe = "body"\namplitude = [9, 0, 0]\nend = 0.57\n')
    coarse = "expected 8: FAIL: the step is too coarse, or the load"
    shown = ended(1, "precision", "run.toml")
    assert coarse in shown.stdout
    assert shown.stderr.count("warning: ") == 1  # not for the half and the quarter of the step as well
    here(BODY.replace("standard", "nontwisting") + TIME + START.replace("0.1]", "0]"))
    assert ended(0, "precision", "run.toml", "--set", 'integrator.name="split"').stdout.splitlines()[-2:] == [
        "no order can be observed: the runs differ by round-off only",
        "take longer steps, or a lower order: --set integrator.order=2",
    ]
    shape = "{ cuboid = { mass = 0.19, lengths = [0.147, 0.0715, 0.0078] } }"  # about its middle axis round-off grows
    here(f'[body]\nkind = "standard"\ninertia = {shape}\n{START}{TIME}')
    for step, verdict in ((0.005, "the runs differ by round-off only"), (0.05, "expected 8: PASS")):
        how = ["start.angular_velocity.body=[0, 9.4, 5e-5]", "time.t_end=8", f"time.step={step}"]
        assert verdict in ended(0, "precision", "run.toml", *(word for one in how for word in ("--set", one))).stdout


MIDPOINT = '[integrator]\nname = "lie-midpoint"\n'
REST = f'{BODY}[start]\nrun = "run.nc"\n[time]\nt_start = 1.0\nt_end = 2.0\nstep = 0.1\n{MIDPOINT}'


def test_resumed_run_is_exact(here):
    here(BODY + START + TIME + MIDPOINT)
    here(REST, "rest.toml")
    ended(0, "run", "run.toml")
    ended(0, "run", "rest.toml", "--set", 'sweep.over=[{key="body.inertia.0", kind="list", values=[3]}]')
    assert "expected 2: PASS" in ended(0, "precision", "rest.toml").stdout
    ended(0, "run", "run.toml", "--set", "time.t_end=2.0", "--out", "whole.nc")
    joined, whole = join_runs(open_run("run.nc"), open_run("rest.nc")), open_run("whole.nc")
    assert np.array_equal(joined["directors"], whole["directors"])
    here(open_run("rest.nc").attrs["run_file"], "again.toml")  # with the hash of run.nc
    ended(0, "check", "again.toml")
    nontwist("run", "run.toml", "--force", "--set", "start.angular_velocity.body=[0, 1, 0]")
    assert "(its content has changed: its hash is " in nontwist("check", "again.toml").stderr


OUTPUTS = ("step=", "store=3", "times={ every = 0.05 }")


@pytest.mark.parametrize(
    "example", [pytest.param(n, marks=[pytest.mark.long] * (n != "case1")) for n in example_names()]
)
def test_check_and_run_agree(here, example):
    ended(0, "example", example)
    file, result = f"{example}.toml", f"{example}.nc"
    schemes, quick = INTEGRATORS.items(), example == "case1"
    for (name, scheme), output in zip(schemes, cycle(OUTPUTS), strict=False) if quick else product(schemes, OUTPUTS):
        step = "" if scheme.any_times and "times" in output else 0.01
        how = [f'integrator={{ name = "{name}" }}', "sweep=", "time.t_end=0.1", f"time.step={step}", f"time.{output}"]
        sets = [word for one in [*how, *["time.store="] * ("times" in output)] for word in ("--set", one)]
        checked = nontwist("check", file, *sets)
        if checked.exit_code == 3 and "integrator" in checked.stderr:
            continue  # it does not take the body or a load
        found, has_steps = numbers_of("run", file, "--force", *sets), "step" in open_run(result).attrs
        assert ("steps" in found) == ("steps" in numbers_of("info", result)) == has_steps, how
        assert ("(automatic)" in checked.stdout) == (step == "" and has_steps) or output == "step=", checked.stdout


def test_dissipation_is_printed(here):
    here(BODY + TIME + START)
    how = ["--set", 'integrator={name="lie-midpoint", options={dissipation=0.25}}']
    assert "lie-midpoint, order 2, dissipation 0.25" in nontwist("check", "run.toml", *how).stdout
    assert "dissipation" not in nontwist("run", "run.toml").stdout


def test_a_comparison_cuts_no_number(here):
    here(BODY + TIME + START)
    how = ["--integrator", "gauss:4", "--step", "0.1", "--step", "0.05", "--every"]
    for width in (60, 67, 80):
        shown = nontwist("compare", "run.toml", *how, COLUMNS=str(width))
        assert "…" not in shown.stdout
        assert max(map(len, shown.stdout.splitlines())) <= width
        assert ("a wider terminal shows" in shown.stderr) == (width < 80)
        assert ("shows 1 more column: " in shown.stderr) == (width == 67)


@pytest.mark.usefixtures("undrawn")
def test_compare(here):
    here(BODY + TIME + START)
    midpoint, steps = ["--integrator", "lie-midpoint:2"], ["--step", "0.1", "--step", "0.05"]
    found = numbers_of("compare", "run.toml", *midpoint, "--integrator", "gauss:4", *steps)
    every = [(name, step) for name in ("lie-midpoint 2", "gauss 4") for step in (0.1, 0.05)]
    assert [(run["integrator"], run["step"]) for run in found["runs"]] == every
    assert found["runs"][1]["attitude_order"] == pytest.approx(2, abs=0.1)
    assert found["runs"][0]["drift_kinetic_energy"] < 1e-13
    more = ["--every", "--figure", "work.svg", "--set", "time.t_end=2"]
    shown = ended(0, "compare", "run.toml", *midpoint, *steps[:2], *more)
    assert shown.stderr.splitlines()[-2:] == [
        "next: nontwist precision run.toml --set time.t_end=2, nontwist run run.toml --set time.t_end=2",
        "written: work.svg",
    ]
    assert "integrators compared" in shown.stdout
    assert [line.split()[0] for line in shown.stdout.splitlines() if re.match("  0", line)] == ["0.1"]
    assert files() == ["run.toml", "work.svg"]
    shown = ended(0, "compare", "run.toml", *midpoint, "--set", 'integrator.name="exact"')
    assert shown.stderr == "next: nontwist run run.toml --set 'integrator.name=\"exact\"'\n"
    drawn = ended(0, "compare", "run.toml", *midpoint, "--figure", "steps.svg", "--against", "steps", "--quiet")
    assert drawn.stderr == "written: steps.svg\n"
    orbit = ["--set", 'load=[{kind="gravity_gradient", mean_motion=0.1, radial=[1, 0, 0], normal=[0, 0, 1]}]']
    code, shown, errors = told("compare", "run.toml", "--integrator", "exact", *orbit)
    assert (code, errors) == (3, "run.toml: no integrator of this comparison solved the problem\n")
    reason = "[1] exact has no closed-form solution for a load that depends on the state; use the integrator gauss"
    assert " ".join(shown.split()).endswith(reason)


def test_examples_are_copied(here):
    Path("sub").mkdir()
    text = nontwist("example", "case1", "--out", "-").stdout
    assert text.startswith("# Case 1 of the paper")
    ended(0, "example", "case1", "--out", "sub")
    ended(0, "example", "case1", "--out", "mine.toml")
    assert files() == ["mine.toml", "sub/case1.toml"]
    assert Path("mine.toml").read_text(encoding="utf-8") == text


def test_debug_shows_the_traceback(here):
    here("a = 1")
    assert "Traceback (most recent call last)" in ended(3, "run", "run.toml", "--debug").stderr


def process(*command, **how):
    source = str(Path(package.__file__).parents[1])  # this copy, wherever it is run from
    environment = {**os.environ, "PYTHONPATH": source, "PYTHONUNBUFFERED": ""}
    return subprocess.run(command, stderr=subprocess.PIPE, text=True, check=False, env=environment, **how)


NONTWIST = [sys.executable, "-m", "nontwist"]


@pytest.mark.skipif(os.name != "posix", reason="needs a shell that closes streams")
def test_closed_stream_is_empty(here):
    """All of them, as a recording without a line is refused."""
    result = process("sh", "-c", f"{shlex.join(NONTWIST)} twist - <&- >&- 2>&-", stdout=subprocess.PIPE)
    assert (result.returncode, result.stdout, result.stderr, files()) == (3, "", "", [])


def test_closed_pipe_and_full_disk(here, capsys, monkeypatch):
    """Also as stdout is closed, which writes what is left."""
    here()
    reading, writing = os.pipe()
    os.close(reading)
    for place, code, told in ((writing, 0, ""), ("/dev/full", 5, "No space left on device")):
        if code and not Path(place).exists():
            pytest.skip("needs /dev/full")
        with open(place, "w", encoding="utf-8") as stdout, monkeypatch.context() as patch:
            patch.setattr(sys, "stdout", stdout)
            with pytest.raises(SystemExit) as stopped:
                app(["check", "run.toml", "--json"])
        assert stopped.value.code == code
        errors = capsys.readouterr().err
        assert (told in errors, "Traceback" in errors, bool(errors)) == (True, False, bool(told))


def test_colours(here):
    here("a = 1")
    assert "\x1b[31m" in nontwist("check", "run.toml", FORCE_COLOR="1", NO_COLOR="").stderr
    assert "\x1b[31m" not in nontwist("check", "run.toml", FORCE_COLOR="1", NO_COLOR="1").stderr


def test_shell_completes_examples():
    words = {"COMP_WORDS": "nontwist example heav", "COMP_CWORD": "2", "_PYTHON _M NONTWIST_COMPLETE": "complete_bash"}
    done = CliRunner().invoke(app, [], env={"_NONTWIST_COMPLETE": "complete_bash", **words}, prog_name="nontwist")
    assert done.stdout.strip() == "heavy_top"


def test_exit_codes_of_other_exceptions():
    assert [code_of(error) for error in (MemoryError(), ImportError(), KeyError())] == [4, 2, None]


def a_pulse(start, end):
    return f'[[load]]\nkind = "pulse"\nframe = "body"\namplitude = [1, 0, 0.5]\nstart = {start}\nend = {end}\n'


TARGET = ["precision", "run.toml", "--target", "1e-9"]


def test_step_of_precision_is_usable(here):
    """Where steps differ from breakpoint to breakpoint, the one that is printed divides the span and has them all."""
    here(BODY + START + "[time]\nt_end = 20\n" + a_pulse(0.37, 1.21))
    shown = nontwist(*TARGET).stdout
    order = re.search(r"gauss, order (\d+)", shown)[1]
    has(shown, " of at most ", f"│ --set time.step=0.01 --set integrator.order={order} (2000 steps) │")
    numbers = numbers_of(*TARGET)
    has(shown, "an error of 1e-09 rad", f"estimated as {numbers['error_estimate']:.1e} rad", "ms, storing what FILE")
    assert numbers["even_step"] == 0.01 < numbers["step"]
    given = ["--set", "time.step=0.01", "--set", f"integrator.order={order}", "--out", "fixed.nc"]
    assert "warning" not in nontwist("run", "run.toml", *given).stderr
    off = nontwist(*TARGET, "--set", "load.0.end=1.2100000234")
    assert "time.tolerance; no step was found that fits the breakpoints" in off.stdout
    again = "--set load.0.end=1.2100000234 --set time.tolerance=1e-09"
    assert off.stderr == f"next: nontwist run run.toml {again}\n"
    alone = numbers_of(*TARGET, "--set", "load=")
    assert alone["even_step"] == alone["step"]
    sweep = '[sweep]\n[[sweep.over]]\nkey = "body.inertia.0"\nkind = "list"\nvalues = [1, 1.2]\n'
    here(BODY + START + "[time]\nt_end = 20\n" + a_pulse(0.37, 1.2100000234) + sweep)
    many = nontwist(*TARGET)
    assert "no step was found that fits the breakpoints; move them to a common grid" in many.stdout
    assert "next:" not in many.stderr


def test_precision_finds_the_order(here, monkeypatch):
    here(BODY + START + "[time]\nt_end = 20\nstep = 0.01\n")
    found = numbers_of(*TARGET)
    here(BODY + START + '[time]\nt_end = 20\nstep = 0.01\n[integrator]\nname = "gauss"\norder = 4\n')
    ticks = iter([0, 0.2, 0.2, 0.3, 0.3, 0.25 + 0.1])  # three runs, of 200, 100 and 50 ms
    with monkeypatch.context() as patch:
        patch.setattr("nontwist.comparison.comparing.perf_counter", lambda: next(ticks))
        numbers = numbers_of(*TARGET)
    assert numbers["seconds"] == pytest.approx(0.05)
    assert numbers | {"seconds": 0} == found | {"seconds": 0}
    assert numbers["order"] > 4
    hint = nontwist(*TARGET).stderr
    assert hint == "next: nontwist run run.toml --set integrator.order= --set time.tolerance=1e-09\n"
    assert numbers_of("run", *hint.split()[3:])["integrator"]["order"] == numbers["order"]
    for choice, order in (
        ("integrator.order=8", 8),
        ('integrator={name="gauss", order=8}', 8),
        ('integrator.name="split"', 6),
        ("time.tolerance=1e-3", numbers["order"]),
    ):
        assert numbers_of(*TARGET, "--set", choice)["order"] == order


def test_time_of_precision(here, monkeypatch):
    here(BODY + START + "[time]\nt_end = 20\nstep = 0.01\ntimes = { every = 0.004 }\n")
    timed = []
    place = "nontwist.comparison.comparing.shortest_times"
    monkeypatch.setattr(place, lambda calls, repeats: {key: timed.append(call()) or 1.0 for key, call in calls.items()})
    assert "│ 1000 ms, storing what FILE stores" in nontwist(*TARGET).stdout
    (run,) = timed
    assert run.time == pytest.approx(np.arange(5001) * 0.004)


def test_steps_until_an_event(here):
    """On a grid that breakpoints divide, too; the last step counts where it is not whole, the time has all digits."""
    event = '[[event]]\nkind = "axis-crosses"\nnormal = [0, 0, 1]\ncosine = 0.99\nterminal = true\n'
    for load in ("", a_pulse(0.3, 0.5)):
        here(BODY + START + "[time]\nt_end = 5\ntolerance = 1e-12\n" + load + event)  # then steps are stored
        shown = nontwist("run", "run.toml", "--force").stdout
        run = open_run("run.nc")
        assert 0.3 < run.time.values[-1] < 4
        steps, states = (re.search(rf"│ {name} +│ (\d+)", shown)[1] for name in ("steps", "states"))
        assert int(steps) == int(states) - 1 == run.sizes["midtime"]
        assert (" of at most " in shown) == bool(load)
        assert ", tolerance 1e-12 " in shown
    last = re.search(r"0 s to (\S+) s", nontwist("info", "run.nc").stdout)[1]
    here(BODY + f'[start]\nrun = "run.nc"\n[time]\nt_start = {last}\nt_end = 5\n', "more.toml")
    ended(0, "run", "more.toml", "--quiet")
    named = nontwist("run", "run.toml", "--force", "--set", 'event.0.name="within 8° again"').stdout
    assert open_run("run.nc").event_name.values.tolist() == ["within 8° again"]
    assert re.search("│ event within 8° again +│ t = ", named)
    header, row = ended(0, "export", "run.nc", "--columns", "event_quaternion").stdout.splitlines()
    assert row.split(",")[header.split(",").index("t_events [s]")] == last
    assert "--columns" in ended(2, "export", "run.nc", "--columns", "event_quaternion,kinetic_energy").stderr
    often, never = (event.replace("0.99\nterminal = true", f'{x}\nname = "{x}"') for x in (0.0, -0.999999))
    here(BODY + START + "[time]\nt_end = 200\nstep = 0.1\n" + often + never)
    shown, count = nontwist("run", "run.toml", "--force").stdout, open_run("run.nc").sizes["event"]
    has(shown, f" s, ... ({count}; nontwist info lists all)", "│ event -0.999999           │ none ")
    assert "lists all" not in nontwist("info", "run.nc").stdout
