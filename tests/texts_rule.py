"""What no trace can see: Python names that ought to change in a loop of the machine. A rule over the syntax tree."""

import ast

STEERING = {"loop", "whilst", "when"}


def steers(node):
    """Whether a statement is a loop or a branch of the machine."""
    f = getattr(getattr(node, "iter", None), "func", None)
    return isinstance(node, ast.For) and getattr(f, "id", getattr(f, "attr", None)) in STEERING


def names(nodes, context):
    """Return lines and names of that context in statements; not those of comprehensions and functions within."""
    found = []
    for top in nodes:
        walked = list(ast.walk(top))
        bound = {
            y.id for x in walked if isinstance(x, ast.comprehension) for y in ast.walk(x.target) if hasattr(y, "id")
        }
        bound |= {a.arg for x in walked if isinstance(x, (ast.FunctionDef, ast.Lambda)) for a in x.args.args}
        own = [x for x in walked if isinstance(x, ast.Name) and isinstance(x.ctx, context)]
        own += [x.target for x in walked if isinstance(x, ast.AugAssign) and hasattr(x.target, "id")]  # both at once
        found += [(x.lineno, x.id) for x in own if x.id not in bound]
    return sorted(found)


def faults(text):
    """Return lines and words of what is wrong in the texts of a module."""
    found = set()
    for f in ast.walk(ast.parse(text)):
        steering = [n for n in ast.walk(f) if steers(n)] if isinstance(f, ast.FunctionDef) else []
        stored, loaded = (names(f.body, context) if steering else [] for context in (ast.Store, ast.Load))
        for n in steering:
            within = names(n.body, ast.Load)
            known = {a.arg for a in [*f.args.args, *f.args.kwonlyargs]} | {x for l, x in stored if l < n.lineno}
            first = {x: l for l, x in reversed(names(n.body, ast.Store))}
            for name, line in first.items():
                if name in known and any(x == name and l <= line for l, x in within):
                    found.add((line, f"{name} changes in the loop at line {n.lineno}: keep it in Variables"))
                end = n.body[-1].end_lineno
                later = [l for l, x in loaded if x == name and l > end]
                anew = [l for l, x in stored if x == name and l > end]
                if later and not any(l <= later[0] for l in anew):
                    found.add((line, f"{name} is used after the loop at line {n.lineno}: keep it in Variables"))
    return sorted(found)
