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
        inner = {y for x in ast.walk(top) if isinstance(x, ast.comprehension) for y in ast.walk(x.target)}
        bound = {y.id for y in inner if isinstance(y, ast.Name)}
        bound |= {a.arg for x in ast.walk(top) if isinstance(x, (ast.FunctionDef, ast.Lambda)) for a in x.args.args}
        found += [
            (x.lineno, x.id)
            for x in ast.walk(top)
            if isinstance(x, ast.Name) and isinstance(x.ctx, context) and x.id not in bound
        ]
    return sorted(found)


def leaves(nodes):
    """Return statements that leave a loop: `return` anywhere, `break` and `continue` outside of loops of their own."""
    found = []
    for node in nodes:
        if isinstance(node, (ast.FunctionDef, ast.Lambda)):
            continue
        if isinstance(node, (ast.Return, ast.Break, ast.Continue)):
            found.append(node)
        inner = leaves(ast.iter_child_nodes(node))
        is_loop = isinstance(node, (ast.For, ast.While)) and not steers(node)
        found += [x for x in inner if isinstance(x, ast.Return) or not is_loop]
    return found


def faults(text):
    """Return lines and words of what is wrong in the texts of a module."""
    found = set()
    for f in ast.walk(ast.parse(text)):
        if not isinstance(f, ast.FunctionDef):
            continue
        arguments = {a.arg for a in [*f.args.args, *f.args.kwonlyargs]}
        steering = list(filter(steers, ast.walk(f)))
        stored, loaded = (names(f.body, context) if steering else [] for context in (ast.Store, ast.Load))
        for n in steering:
            within = names(n.body, ast.Load)
            first = {}
            for line, name in names(n.body, ast.Store):
                first.setdefault(name, line)
            for name, line in first.items():
                is_known = name in arguments or any(x == name and l < n.lineno for l, x in stored)
                early = any(x == name and l <= line for l, x in within)
                if is_known and (early or any(name == x for _, x in augmented(n.body))):
                    found.add((line, f"{name} changes in the loop at line {n.lineno}: keep it in Variables"))
                end = n.body[-1].end_lineno
                later = [l for l, x in loaded if x == name and l > end]
                anew = [l for l, x in stored if x == name and l > end]
                if later and not any(l <= later[0] for l in anew):
                    found.add((line, f"{name} is used after the loop at line {n.lineno}: keep it in Variables"))
            for x in leaves(n.body):
                found.add((x.lineno, f"{type(x).__name__.lower()} leaves the loop at line {n.lineno}"))
    return sorted(found)


def augmented(nodes):
    """Return lines and names of `name += ...`."""
    walked = (x for n in nodes for x in ast.walk(n) if isinstance(x, ast.AugAssign) and isinstance(x.target, ast.Name))
    return [(x.lineno, x.target.id) for x in walked]
