"""Plant faults in the package, one at a time, and see which of them the quick suite finds: `make mutations`.

A statement is drawn uniformly from each module of more than 100 lines and from the others together, so that each has
its share; then a kind of fault that it can have (a sign, a factor, a bound, a condition, off by one, a dropped term),
then a place in it. Tests that run the statement are run, those that are most about its module first, until one fails.
Which tests run a statement is measured first, file by file, since a kernel is traced once a process. Files that compare
with stored output (STORED) are left out: a fault that they alone would find counts as not found.
"""

import argparse
import ast
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from queue import Queue

ROOT = Path(__file__).parent.parent
STORED = {"tests/covering/test_same_numbers.py", "tests/powers/test_powers.py", "tests/recordings/test_same.py"}
STORED |= {"tests/test_language.py", "tests/test_docs_site.py", "tests/test_pages.py"}
MOST, TOGETHER = 24, 4  # files of tests that are run for a fault, and at a time
ENDLESS = 20  # times as long as without a fault, with coverage measured: a run that does not end
PASSED = (0, 5)  # exit statuses of pytest: all passed, none was left to run
SWAPPED = {ast.Add: "-", ast.Sub: "+", ast.Mult: "/", ast.Div: "*"}
REVERSED = {ast.Lt: ">", ast.LtE: ">", ast.Gt: "<", ast.GtE: "<", ast.Eq: "!=", ast.NotEq: "=="}
QUICK = ["-q", "-x", "-n", "0", "-p", "no:cacheprovider", "-m", "not long"]


@dataclass(frozen=True)
class Fault:
    """A change of `old` to `new` at a place of a module."""

    module: str
    line: int
    kind: str
    start: int
    end: int
    old: str
    new: str

    def planted(self, text):
        """The module's text with the fault in it."""
        data = text.encode()
        return (data[: self.start] + self.new.encode() + data[self.end :]).decode()


def is_text(node):
    return isinstance(node, ast.JoinedStr) or (isinstance(node, ast.Constant) and isinstance(node.value, str))


class Places(ast.NodeVisitor):
    """The faults that a statement can have: what belongs to statements inside it is theirs."""

    def __init__(self, module, text):
        self.module, self.text, self.found = module, text, []
        self.starts = [0]
        for line in text.encode().splitlines(keepends=True):
            self.starts.append(self.starts[-1] + len(line))

    def add(self, kind, node, new):
        """Note that `node` can become the text `new`."""
        start = self.starts[node.lineno - 1] + node.col_offset
        end = self.starts[node.end_lineno - 1] + node.end_col_offset
        old = self.text.encode()[start:end].decode()
        self.found.append(Fault(self.module, node.lineno, kind, start, end, old, new))

    def of(self, node):
        return ast.get_source_segment(self.text, node)

    def visit_BinOp(self, node):
        left, right = self.of(node.left), self.of(node.right)
        if type(node.op) in SWAPPED and not any(map(is_text, (node.left, node.right))):
            kind = "sign" if isinstance(node.op, (ast.Add, ast.Sub)) else "factor"
            self.add(kind, node, f"({left} {SWAPPED[type(node.op)]} {right})")
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

    def visit_Constant(self, node):
        if type(node.value) is int:
            self.add("off by one", node, repr(node.value + 1))
        elif type(node.value) is float and node.value:
            self.add("factor", node, repr(2 * node.value))

    def statement(self, node):
        """The faults of one statement."""
        if isinstance(node, ast.If) and self.of(node.test) == "TYPE_CHECKING":
            return []
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant) and type(node.value.value) is float:
            self.add("bound", node.value, repr(10 * node.value.value))
        elif isinstance(node, (ast.If, ast.While)):
            self.add("condition", node.test, f"(not ({self.of(node.test)}))")
            self.visit(node.test)
        elif isinstance(node, ast.For):
            self.visit(node.iter)
        elif (
            isinstance(node, (ast.Return, ast.Assign, ast.AugAssign, ast.AnnAssign, ast.Expr))
            and node.value is not None
        ):
            if isinstance(node, ast.AugAssign) or (isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)):
                self.add("dropped term", node, "pass")
            self.visit(node.value)
        found, self.found = self.found, []
        return found


def statements(path):
    """Each statement of a module that can have a fault, as the list of its faults."""
    text = path.read_text(encoding="utf-8")
    places = Places(str(path.relative_to(ROOT)), text)
    lists = [places.statement(node) for node in ast.walk(ast.parse(text)) if isinstance(node, ast.stmt)]
    return [faults for faults in lists if faults]


def drawn(number, seed):
    """That many faults, over modules by their statements: a module of more than 100 lines has one at least."""
    rng = random.Random(seed)
    of_modules = {p: statements(p) for p in sorted((ROOT / "src").rglob("*.py"))}
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
    """A copy of the checkout in which faults are planted."""
    skipped = shutil.ignore_patterns(".git", ".venv", "build", "dist", "__pycache__", ".*_cache")
    shutil.copytree(ROOT, folder, ignore=skipped)
    return folder


def ran(folder, arguments, seconds, **environment):
    """The exit status of a command in a copy; None where it takes longer."""
    env = (
        os.environ
        | {"PYTHONPATH": str(folder / "src"), "PYTHONDONTWRITEBYTECODE": "1", "NONTWIST_ANY_SENTENCE": "1"}
        | environment
    )
    try:
        done = subprocess.run([sys.executable, *arguments], cwd=folder, env=env, capture_output=True, timeout=seconds)
    except subprocess.TimeoutExpired:
        return None
    return done.returncode


def measured(folder, file):
    """The lines of each module that a file of tests runs, and the seconds that it takes; None where it fails."""
    data, report = folder / "coverage", folder / "coverage.json"
    started = time.perf_counter()
    settings = ["--source=src/nontwist", f"--data-file={data}"]
    if ran(folder, ["-m", "coverage", "run", *settings, "-m", "pytest", *QUICK, file], None) not in PASSED:
        return None
    seconds = time.perf_counter() - started
    ran(folder, ["-m", "coverage", "json", "-q", f"--data-file={data}", "-o", str(report)], None)
    files = json.loads(report.read_text(encoding="utf-8"))["files"]
    return {"seconds": seconds, "lines": {name: of["executed_lines"] for name, of in files.items()}}


def each(workers, copies, work, items):
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

    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(one, items))


def tests_of(fault, map_of_tests):
    """The files of tests that run a statement, those first that are most about its module."""
    scores = {}
    at_import = set.intersection(*(set(m["lines"].get(fault.module, [])) for m in map_of_tests.values()))
    for file, measure in map_of_tests.items():
        lines = set(measure["lines"].get(fault.module, []))
        if fault.line in lines and lines - at_import:
            own = len(lines - at_import)
            scores[file] = own**2 / sum(map(len, measure["lines"].values())) / measure["seconds"] ** 0.5
    return sorted(scores, key=scores.get, reverse=True)


def looked_for(copy, fault, map_of_tests):
    """The files of tests that find a fault; an empty text where none does.

    Tests that take many times as long as without the fault find it: it may go on without end.
    """
    path = copy / fault.module
    clean = path.read_text(encoding="utf-8")
    path.write_text(fault.planted(clean), encoding="utf-8")
    files = tests_of(fault, map_of_tests)[:MOST]
    try:
        for first in range(0, len(files), TOGETHER):
            part = files[first : first + TOGETHER]
            seconds = sum(map_of_tests[file]["seconds"] for file in part)
            if ran(copy, ["-m", "pytest", *QUICK, *part], ENDLESS * seconds) not in PASSED:
                return " ".join(part)
    finally:
        path.write_text(clean, encoding="utf-8")
    return ""


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--number", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--map", type=Path, help="keep which tests run which lines in this file, or read it from there")
    parser.add_argument("--list", action="store_true", help="list the faults, and plant none")
    options = parser.parse_args()
    faults = drawn(options.number, options.seed)
    if options.list:
        for fault in faults:
            print(f"{fault.module}:{fault.line} {fault.kind}: {fault.old!r} -> {fault.new!r}")
        return
    with tempfile.TemporaryDirectory() as folder:
        copies = [copied(Path(folder) / str(k)) for k in range(options.workers)]
        if options.map and options.map.exists():
            map_of_tests = json.loads(options.map.read_text(encoding="utf-8"))
        else:
            files = sorted(str(p.relative_to(ROOT)) for p in (ROOT / "tests").rglob("test_*.py"))
            files = [file for file in files if file not in STORED]
            measures = each(options.workers, copies, measured, files)
            map_of_tests = {file: m for file, m in zip(files, measures, strict=True) if m}
            if options.map:
                options.map.write_text(json.dumps(map_of_tests), encoding="utf-8")
        found = Counter()

        def told(copy, fault):
            by = looked_for(copy, fault, map_of_tests)
            found[fault.kind, bool(by)] += 1
            word = f"found by {by}" if by else "NOT FOUND"
            print(f"{fault.module}:{fault.line} {fault.kind}: {fault.old!r} -> {fault.new!r}: {word}", flush=True)
            return bool(by)

        results = each(options.workers, copies, told, faults)
    for kind in sorted({kind for kind, _ in found}):
        print(f"{kind}: {found[kind, True]} of {found[kind, True] + found[kind, False]}")
    print(f"seed {options.seed}: {sum(results)} of {len(results)} found, {100 * sum(results) / len(results):.1f} %")


if __name__ == "__main__":
    main()
