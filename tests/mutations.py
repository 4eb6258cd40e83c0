"""Plant faults in the package, one at a time, and see which of them the quick suite finds: `make mutations`.

A statement is drawn uniformly from each module of more than 100 lines and from the others together, so that each has
its share; then a kind of fault that it can have (a sign, a factor, a bound, a condition, off by one, a dropped term),
then a place in it. Which tests run which lines is measured first, in a process for each file, since a kernel is traced
once a process. Tests that run the statement, or that use the constant, are run until one fails: the quickest and those
most about the module first; then others of their files, as a kernel or a cache is made in the first of them alone. Of a
statement that no test runs in its own process, they are those that run the module. Tests that fail without a fault are
left out.
Files that compare with stored output (STORED) are left out: a fault that they alone would find counts as not found.
Reasons for those that are not found are in tests/data/survivors.json, by module and faulty line, or the statement that
is left out. A zero of the type of another number, 0.0 * x, is added and not subtracted: a sign there is no fault.
"""

import argparse
import ast
import compileall
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from py_compile import PycInvalidationMode
from queue import Queue

from coverage import Coverage, CoverageData

ROOT = Path(__file__).parent.parent
REASONS = ROOT / "tests" / "data" / "survivors.json"
STORED = {"tests/covering/test_same_numbers.py", "tests/powers/test_powers.py", "tests/recordings/test_same.py"}
STORED |= {"tests/pages/test_language.py", "tests/pages/test_docs_site.py", "tests/pages/test_pages.py"}
SHARES = (0.006, 0.05, 0.02)  # of the time of all tests: the first ones, the others, more of their files
ENDLESS, AT_LEAST = 20, 120  # a run that takes so many times as long as without a fault, and these seconds, has no end
TINIEST = 1e-290  # smaller numbers guard against a division by 0, which any other does
PASSED = (0, 5)  # exit statuses of pytest: all passed, none was left to run
SWAPPED = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*"}
REVERSED = {ast.Lt: ">", ast.LtE: ">", ast.Gt: "<", ast.GtE: "<", ast.Eq: "!=", ast.NotEq: "=="}
SEEN = {}  # of each test, the seconds that it takes and whether it passes
QUICK = ["-q", "-n", "0", "-p", "no:cacheprovider", "-m", "not long"]


@dataclass(frozen=True)
class Fault:
    """A change of `old` to `new` at a place of a module, in the statement on the lines from `first` to `last`."""

    module: str
    line: int
    kind: str
    start: int
    end: int
    old: str
    new: str
    first: int = 0
    last: int = 0
    names: tuple[str, ...] = ()

    def __str__(self):
        return f"{self.module}:{self.line} {self.kind}: {self.old!r} -> {self.new!r}"

    def told(self, text):
        """The module and the faulty line, or the statement that is left out, by which a reason is known."""
        line = self.planted(text).splitlines()[self.line - 1].strip()
        return f"{self.module}: {f'without {self.old}' if self.new == 'pass' else line}"

    def planted(self, text):
        """The module's text with the fault in it."""
        data = text.encode()
        return (data[: self.start] + self.new.encode() + data[self.end :]).decode()


def is_text(node):
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))


class Places(ast.NodeVisitor):
    """The faults that a statement can have: what belongs to statements inside it is theirs."""

    def __init__(self, module, text):
        self.module, self.text, self.found, self.any = module, text.encode(), [], set()
        self.starts = [0]
        for line in self.text.splitlines(keepends=True):
            self.starts.append(self.starts[-1] + len(line))

    def add(self, kind, node, new):
        """Note that `node` can become the text `new`."""
        self.found.append(Fault(self.module, node.lineno, kind, *self.span(node), self.of(node), new))

    def span(self, node):
        """The first byte of a node, and the first behind it."""
        ends = (node.lineno, node.col_offset), (node.end_lineno, node.end_col_offset)
        return [self.starts[line - 1] + column for line, column in ends]

    def of(self, node):
        return self.text[slice(*self.span(node))].decode()

    def visit_BinOp(self, node):
        left, right = self.of(node.left), self.of(node.right)
        if type(node.op) in SWAPPED and not any(map(is_text, (node.left, node.right))):
            kind = "sign" if isinstance(node.op, (ast.Add, ast.Sub)) else "factor"
            if kind == "factor" or not right.startswith("0.0 * "):
                self.add(kind, node, f"(({left}) {SWAPPED[type(node.op)]} ({right}))")
            if (left, kind) != ("0.0", "factor"):  # 0 times a number is 0 as well
                self.add("dropped term", node, f"({left})")
        self.generic_visit(node)

    def visit_UnaryOp(self, node):
        if isinstance(node.op, ast.USub):
            self.add("sign", node, f"(+{self.of(node.operand)})")
        elif isinstance(node.op, ast.Not):
            self.add("condition", node, f"bool({self.of(node.operand)})")
        self.generic_visit(node)

    def visit_BoolOp(self, node):
        other = " or " if isinstance(node.op, ast.And) else " and "
        self.add("condition", node, "(" + other.join(f"({self.of(v)})" for v in node.values) + ")")
        self.generic_visit(node)

    def visit_Compare(self, node):
        if len(node.ops) == 1:
            right = node.comparators[0]
            if type(node.ops[0]) in REVERSED:
                new = f"({self.of(node.left)} {REVERSED[type(node.ops[0])]} {self.of(right)})"
                self.add("condition", node, new)
            for side in (node.left, right):
                if isinstance(side, ast.Constant) and type(side.value) in (int, float):
                    moved = side.value + 1 if isinstance(side.value, int) else side.value * 10 or 0.1
                    self.add("bound", side, repr(moved))
        self.generic_visit(node)

    def visit_IfExp(self, node):
        self.add("condition", node.test, f"(not ({self.of(node.test)}))")
        self.generic_visit(node)

    def visit_Call(self, node):
        """Note which numbers may be any others: a seed, and the length that reshape finds, which is any below 0."""
        name = getattr(node.func, "attr", "")
        if name == "default_rng":
            self.any.update(node.args)
        elif name == "reshape":
            self.any.update(one.operand for one in node.args if isinstance(one, ast.UnaryOp))
        self.generic_visit(node)

    def visit_Constant(self, node):
        if node in self.any:
            return
        if type(node.value) is int:
            self.add("off by one", node, repr(node.value + 1))
        elif type(node.value) is float and node.value > TINIEST:
            self.add("factor", node, repr(2 * node.value))

    def statement(self, node):
        """The faults of one statement."""
        part = {ast.If: "test", ast.While: "test", ast.For: "iter"}.get(type(node), "value")
        inside = getattr(node, part, None)
        if inside is None or getattr(inside, "id", "") == "TYPE_CHECKING":
            return []
        if isinstance(node, ast.Assign) and isinstance(inside, ast.Constant) and type(inside.value) is float:
            self.add("bound", inside, repr(10 * inside.value or 0.1))
        elif part == "test":
            self.add("condition", inside, f"(not ({self.of(inside)}))")
        elif isinstance(node, ast.AugAssign) or (isinstance(node, ast.Expr) and isinstance(inside, ast.Call)):
            self.add("dropped term", node, "pass")
        self.visit(inside)
        last = (node if part == "value" else inside).end_lineno
        targets = getattr(node, "targets", [getattr(node, "target", None)])
        names = tuple(n.id for target in targets if target for n in ast.walk(target) if isinstance(n, ast.Name))
        found, self.found = self.found, []
        return [replace(fault, first=node.lineno, last=last, names=names) for fault in found]


def statements(path):
    """Each statement of a module that can have a fault, as the list of its faults."""
    text = path.read_text(encoding="utf-8")
    places = Places(str(path.relative_to(ROOT)), text)
    lists = [places.statement(node) for node in ast.walk(ast.parse(text)) if isinstance(node, ast.stmt)]
    return [faults for faults in lists if faults]


def drawn(number, seed, only=("src",)):
    """That many faults, over modules by their statements: a module of more than 100 lines has one at least."""
    rng, folders = random.Random(seed), [ROOT / one for one in only]
    of_modules = {p: statements(p) for p in sorted((ROOT / "src").rglob("*.py")) if {p, *p.parents} & {*folders}}
    total = sum(map(len, of_modules.values()))
    faults, small = [], []
    for path, lists in of_modules.items():
        if len(path.read_text(encoding="utf-8").splitlines()) > 100 and lists:
            share = number * len(lists) / total
            count = max(1, int(share) + (rng.random() < share % 1))
            faults += [one_of(rng, lists) for _ in range(count)]
        else:
            small += lists
    while small and len(faults) < number:
        faults.append(one_of(rng, small))
    rng.shuffle(faults)
    return list(dict.fromkeys(faults))


def one_of(rng, lists):
    """A fault of a statement that is drawn: first its kind, then its place."""
    faults = rng.choice(lists)
    kind = rng.choice(sorted({fault.kind for fault in faults}))
    return rng.choice([fault for fault in faults if fault.kind == kind])


def copied(folder):
    """A copy of the checkout in which faults are planted; what is compiled there is checked by its text."""
    skipped = shutil.ignore_patterns(".git", ".venv", "build", "dist", "__pycache__", ".*_cache")
    shutil.copytree(ROOT, folder, ignore=skipped)
    compileall.compile_dir(folder / "src", quiet=2, invalidation_mode=PycInvalidationMode.CHECKED_HASH)
    return folder


def ran(folder, arguments, seconds=None):
    """The exit status and the output of Python in a copy; the status is None where it takes longer."""
    path = os.pathsep.join(str(folder / part) for part in ("src", "tests"))
    output, env = folder / "output.txt", os.environ | {"PYTHONPATH": path, "NONTWIST_ANY_SENTENCE": "1"}
    with open(output, "wb") as file:
        how = {"cwd": folder, "env": env, "stdout": file, "stderr": file, "start_new_session": True}
        process = subprocess.Popen([sys.executable, *arguments], **how)
        try:
            process.wait(seconds)
        except subprocess.TimeoutExpired:
            pass
        finally:
            status = process.poll()
            if status is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
    return status, output.read_text(encoding="utf-8", errors="replace")


@dataclass(frozen=True, eq=False)
class Test:
    """A test: its name for pytest, its seconds, and the lines that it runs of each module, as bits of a number."""

    name: str
    seconds: float
    lines: dict[str, int]

    @property
    def file(self):
        return self.name.partition("::")[0]


def bits(lines):
    return sum(1 << line for line in set(lines))


def pytest_runtest_protocol(item):
    """Let coverage note what a test runs, where pytest has this module as a plugin."""
    Coverage.current().switch_context(item.nodeid)


def pytest_runtest_logreport(report):
    """Add up the seconds of a test, and note whether it passes."""
    seconds, passes = SEEN.get(report.nodeid, (0.0, True))
    SEEN[report.nodeid] = seconds + report.duration, passes and not report.failed


def pytest_sessionfinish():
    Path("seen.json").write_text(json.dumps(SEEN), encoding="utf-8")


def measured(folder, file):
    """The tests of a file, but for those that fail."""
    data, seen = folder / "coverage", folder / "seen.json"
    for path in (data, seen):
        path.unlink(missing_ok=True)
    coverage = ["-m", "coverage", "run", "--source=src/nontwist", f"--data-file={data}"]
    status, output = ran(folder, [*coverage, "-m", "pytest", *QUICK, "-p", "mutations", file])
    if status not in (*PASSED, 1):
        print(f"{file} is left out: {output[-500:]}", flush=True)
        return []
    lines = defaultdict(lambda: defaultdict(int))
    found = CoverageData(str(data))
    found.read()
    for path in found.measured_files():
        for line, names in found.contexts_by_lineno(path).items():
            for name in names:
                lines[name][str(Path(path).relative_to(folder))] |= 1 << line
    tests = []
    for name, (seconds, passes) in json.loads(seen.read_text(encoding="utf-8")).items():
        if passes:
            tests.append(Test(name, seconds, dict(lines[name])))
        else:
            print(f"{name} is left out: it fails without a fault", flush=True)
    return tests


def each(copies, work, items):
    """What `work(copy, item)` gives, in the order of the items, each in a copy of its own."""
    free = Queue()
    for copy in copies:
        free.put(copy)

    def one(item):
        copy = free.get()
        try:
            return work(copy, item)
        finally:
            free.put(copy)

    with ThreadPoolExecutor(len(copies)) as pool:
        try:
            return list(pool.map(one, items))
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            print("interrupted")


class Map:
    """Which tests run which lines of the modules."""

    def __init__(self, tests):
        self.tests = tests
        self.all_seconds = sum(test.seconds for test in tests)
        self.texts = {str(p.relative_to(ROOT)): p.read_text(encoding="utf-8") for p in (ROOT / "src").rglob("*.py")}
        self.in_functions = {module: self._in_functions(text) for module, text in self.texts.items()}

    def _in_functions(self, text):
        """The lines that run when a module is used, and not as it is imported."""
        functions = [n for n in ast.walk(ast.parse(text)) if isinstance(n, (ast.FunctionDef, ast.AsyncFunctionDef))]
        return bits(line for f in functions for line in range(f.body[0].lineno, f.end_lineno + 1))

    def places(self, fault):
        """The lines that run a fault: its statement, or those that use the name of a constant."""
        own = bits(range(fault.first, fault.last + 1))
        if own & self.in_functions[fault.module]:
            return {fault.module: own}
        word = re.compile(rf"\b({'|'.join(fault.names)})\b") if fault.names else None
        found = {}
        for module, text in self.texts.items():
            lines = enumerate(text.splitlines(), 1)
            found[module] = self.in_functions[module]
            found[module] &= bits(k for k, line in lines if word and word.search(line))
        return found if any(found.values()) else {fault.module: self.in_functions[fault.module]}

    def chosen(self, fault):
        """Tests that run a fault, with their seconds: the first ones, the others, more tests of their files."""
        inside, mean, scores = self.in_functions[fault.module], self.all_seconds / len(self.tests), {}
        for test in self.tests:
            share = (test.lines.get(fault.module, 0) & inside).bit_count() + 1
            scores[test] = share / (sum(map(int.bit_count, test.lines.values())) + 1) / (test.seconds + mean)
        for places in (self.places(fault), {fault.module: inside}):  # a statement that other processes run has no tests
            run = [t for t in self.tests if any(t.lines.get(module, 0) & lines for module, lines in places.items())]
            if run:
                break
        run.sort(key=scores.get, reverse=True)
        files = list(dict.fromkeys(test.file for test in run))
        beside = sorted((t for t in self.tests if t.file in files), key=lambda t: (files.index(t.file), t.seconds))
        parts, left, seen = [[], [], []], [share * self.all_seconds for share in SHARES], set()
        for tests, places in ((run, (0, 1)), (beside, (2,))):
            for test in tests:
                k = next((k for k in places if left[k] > test.seconds or not parts[0]), 3)
                if k < 3 and test not in seen:
                    parts[k].append(test.name)
                    left[k] -= test.seconds
                    seen.add(test)
        return [(part, share * self.all_seconds - rest) for part, share, rest in zip(parts, SHARES, left, strict=True)]

    def found_by(self, copy, fault):
        """The test that finds a fault; an empty text where none does."""
        path = copy / fault.module
        clean = path.read_text(encoding="utf-8")
        for names, seconds in self.chosen(fault):
            path.write_text(fault.planted(clean), encoding="utf-8")
            try:
                limit = max(AT_LEAST, ENDLESS * seconds)
                status, output = ran(copy, ["-m", "pytest", *QUICK, "-x", *names], limit) if names else (0, "")
            finally:
                path.write_text(clean, encoding="utf-8")
            if status not in (*PASSED, -signal.SIGKILL):
                failed = re.findall(r"^(?:FAILED|ERROR) (tests/.+?)(?: - .*)?$", output, re.MULTILINE)
                return (failed or ["a run without end" if status is None else f"the exit status {status}"])[0]
        return ""


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--number", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--only", nargs="+", default=["src"], help="files or folders in which faults are planted")
    parser.add_argument("--map", type=Path, help="keep which tests run which lines in this file, or read it from there")
    parser.add_argument("--list", action="store_true", help="list the faults, and plant none")
    options = parser.parse_args()
    faults = drawn(options.number, options.seed, options.only)
    if options.list:
        print(*faults, sep="\n")
        return
    reasons = json.loads(REASONS.read_text(encoding="utf-8"))
    started, results = time.monotonic(), {}
    with tempfile.TemporaryDirectory() as folder:
        copies = [copied(Path(folder) / str(k)) for k in range(options.workers)]
        if options.map and options.map.exists():
            tests = [Test(**one) for one in json.loads(options.map.read_text(encoding="utf-8"))]
        else:
            files = sorted(str(p.relative_to(ROOT)) for p in (ROOT / "tests").rglob("test_*.py"))
            lists = each(copies, measured, [file for file in files if file not in STORED])
            tests = [test for of_file in lists for test in of_file]
            if options.map:
                options.map.write_text(json.dumps([vars(test) for test in tests]), encoding="utf-8")
        print(f"{len(tests)} tests measured after {time.monotonic() - started:.0f} s", flush=True)
        tests = Map(tests)

        def told(copy, fault):
            results[fault] = by = tests.found_by(copy, fault)
            reason = reasons.get(fault.told(tests.texts[fault.module]), "no reason is known")
            how = f"found by {by}" if by else f"NOT FOUND, {reason}"
            print(f"{len(results)}/{len(faults)} {fault}: {how}", flush=True)

        each(copies, told, faults)
    for kind in sorted({fault.kind for fault in results}):
        of_kind = [bool(by) for fault, by in results.items() if fault.kind == kind]
        print(f"{kind}: {sum(of_kind)} of {len(of_kind)}")
    found, minutes = sum(map(bool, results.values())), (time.monotonic() - started) / 60
    share = 100 * found / max(1, len(results))
    print(f"seed {options.seed}: {found} of {len(results)} found, {share:.1f} %, in {minutes:.0f} min")


if __name__ == "__main__":
    main()
