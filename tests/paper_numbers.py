"""The printed numbers of the paper's labels and theorems, counted in its source as LaTeX counts.

`python tests/paper_numbers.py PAPER.tex` writes src/nontwist/paper/labels.json. The paper's source is not a part of the
repository; the numbers are those of the .aux file that pdfLaTeX writes for it.

The rules of the class `article` with amsmath: equations count through the whole document, one for `equation`, one for
each row of `align` but those with \\nonumber; in `subequations` the whole has one number and its rows have letters.
Theorems count within sections, figures and tables through the document, sections after \\appendix have letters. A label
names what was counted last in the environments that are open around it.
"""

import json
import re
import sys
from pathlib import Path

FILE = Path(__file__).parents[1] / "src" / "nontwist" / "paper" / "labels.json"
TOKEN = re.compile(
    r"\\(?P<row>\\)(?:\[[^]]*\])?|\\(?P<word>begin|end|label|section|subsection|appendix|nonumber|notag|caption)\b\*?"
    r"(?:\s*\{(?P<of>[^{}]*)\})?"
)
ROWS = ("align", "gather")
OTHERS = ("eqnarray", "multline", "alignat", "flalign")


def without_comments(text):
    """Return the body of a document without its comments; a percent sign behind a backslash is printed."""
    body = text.partition(r"\begin{document}")[2].partition(r"\end{document}")[0]
    return re.sub(r"(?<!\\)%.*", "", body or text)


class Counter:
    """What LaTeX counts while it reads."""

    def __init__(self):
        self.counts = dict.fromkeys(("section", "subsection", "equation", "theorem", "figure", "table"), 0)
        self.appendix = False
        self.parent = None  # the number of the subequations that are open, and the rows in them
        self.current = [""]  # what a label would name, for each open environment
        self.labels, self.theorems = {}, []

    def section(self):
        number = self.counts["section"]
        return chr(ord("A") + number - 1) if self.appendix else str(number)

    def step(self, name):
        """Count one, and make it what a label names."""
        if name == "equation" and self.parent is not None:
            self.parent[1] += 1
            found = f"{self.parent[0]}{chr(ord('a') + self.parent[1] - 1)}"
        else:
            self.counts[name] += 1
            found = str(self.counts[name])
        if name == "section":
            self.counts["subsection"] = self.counts["theorem"] = 0
            found = self.section()
        elif name in ("subsection", "theorem"):
            found = f"{self.section()}.{found}"
        if name == "theorem":
            self.theorems.append(found)
        self.current[-1] = found

    def back(self):
        """Take the number of the last row, or equation, back."""
        if self.parent is not None:
            self.parent[1] -= 1
        else:
            self.counts["equation"] -= 1

    def begin(self, name):
        self.current.append(self.current[-1])
        if name in OTHERS:
            raise ValueError(f"no rule for {name}")
        if name in ("equation", "theorem", *ROWS):
            self.step("equation" if name in ROWS else name)
        elif name == "subequations":
            self.step("equation")
            self.parent = [self.current[-1], 0]

    def end(self, name):
        if name == "subequations":
            self.parent = None
        self.current.pop()

    def read(self, text):
        """Count through a text; return the labels with their numbers."""
        inside = []
        for token in TOKEN.finditer(without_comments(text)):
            word, of = token["word"], token["of"]
            if token["row"]:
                if inside and inside[-1] in ROWS:
                    self.step("equation")
            elif word == "begin":
                inside.append(of)
                self.begin(of)
            elif word == "end":
                inside.pop()
                self.end(of)
            elif word == "label":
                self.labels[of] = self.current[-1]
            elif word == "appendix":
                self.appendix, self.counts["section"] = True, 0
            elif word == "caption":
                self.step(next(name for name in reversed(inside) if name in ("figure", "table")))
            elif word in ("nonumber", "notag"):
                self.back()
            elif not token[0].startswith(f"\\{word}*"):
                self.step(word)
        return self.labels


def numbers(text):
    """Return the labels with their printed numbers, and the numbers of the theorems."""
    counter = Counter()
    return {"labels": counter.read(text), "theorems": counter.theorems}


if __name__ == "__main__":
    found = numbers(Path(sys.argv[1]).read_text(encoding="utf-8"))
    FILE.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")
    print(f"{len(found['labels'])} labels, {len(found['theorems'])} theorems: {FILE}")
