"""The bugs that can be planted in Python: mistakes that people make, found by the syntax tree.

There is no bug in what only a person reads: texts, annotations, docstrings, messages, the look of a
figure. There is none without an effect on results: the factor of a rounding margin, `strict=`, and
the order of commuting operands.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from copy import deepcopy
from itertools import pairwise
from typing import Any, NamedTuple

from tests.mutation.mutant import Mutant, planted

_ORDER: dict[type[ast.cmpop], dict[type[ast.cmpop], str]] = {
    ast.Lt: {ast.LtE: "boundary", ast.GtE: "condition inverted"},
    ast.LtE: {ast.Lt: "boundary", ast.Gt: "condition inverted"},
    ast.Gt: {ast.GtE: "boundary", ast.LtE: "condition inverted"},
    ast.GtE: {ast.Gt: "boundary", ast.Lt: "condition inverted"},
    ast.Eq: {ast.NotEq: "condition inverted"},
    ast.NotEq: {ast.Eq: "condition inverted"},
    ast.Is: {ast.IsNot: "condition inverted"},
    ast.IsNot: {ast.Is: "condition inverted"},
    ast.In: {ast.NotIn: "condition inverted"},
    ast.NotIn: {ast.In: "condition inverted"},
}
_ARITHMETIC: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.FloorDiv: ast.Mult,
    ast.Div: ast.Mult,
    ast.Mod: ast.FloorDiv,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}
_PAIRS = ["min max", "floor ceil", "argmin argmax", "minimum maximum", "any all", "mean median"]
_PAIRS += ["append appendleft", "pop popleft", "radians degrees", "nanmin nanmax"]
_NEIGHBOUR = {a: b for pair in _PAIRS for a, b in (pair.split(), pair.split()[::-1])}
_UNIT = re.compile(
    r"(1_?000|1_?000_?000|1_?000_?000_?000|1(\.0)?e-?[369]|60|3600|8|1000.0|"
    r"(\d \* )?(np|math)\.pi|[A-Z]+_PER_[A-Z]+|1000000(\.0|000)?|0\.001|1e-0[69])"
)
_SYMMETRIC = {"min", "max", "minimum", "maximum", "hypot", "isclose", "gcd", "print", "isinstance"}
_SYMMETRIC |= {"convolve"}
_FLUSHES = {"flush", "sync", "fsync", "clear", "discard", "close", "release", "end", "stop"}
_FLUSHES |= {"notify", "notify_all", "set", "cancel", "join", "terminate", "kill", "unlink"}
_LOGS = re.compile(r"(log|logger|logging|warnings)\.(debug|info|warning|warn|error)|print|say")
_LOOKS = {
    "linewidth",
    "lw",
    "fontsize",
    "size",
    "zorder",
    "pad",
    "rotation",
    "figsize",
    "s",
    "width",
}
_LOOKS |= {
    "alpha",
    "color",
    "markersize",
    "ms",
    "labelpad",
    "height",
    "ncols",
    "loc",
    "borderaxespad",
}
_NO_RESULT = {"strict", "refresh_per_second"}
_TITLES = re.compile(r"\w+\.(set_(title|[xy](label|ticks|ticklabels))|suptitle|legend|grid)")
_FIGURES = re.compile(r"figures?\.py$|plots/")
_MARGIN = 1e-6  # shares below it absorb rounding
_SMALL = 10
"""Above it a number is doubled: one more would change a limit too little to matter."""


class _Edit(NamedTuple):
    """The text from the start of a node to the end of another is replaced."""

    first: ast.AST
    last: ast.AST
    new: str
    kind: str


def sites(file: str, source: str) -> list[Mutant]:
    """Return the bugs that can be planted in a file."""
    begins = [0]  # of lines, in characters
    lines = source.split("\n")
    for line in lines:
        begins.append(begins[-1] + len(line) + 1)

    def offset(line: int, column: int) -> int:  # a column counts bytes
        return begins[line - 1] + len(lines[line - 1].encode()[:column].decode())

    def mutant(edit: _Edit) -> Mutant:
        first: Any = edit.first
        last: Any = edit.last
        start = offset(first.lineno, first.col_offset)
        if edit.kind == "case never met":
            start = offset(last.end_lineno, last.end_col_offset)
        end = offset(last.end_lineno, last.end_col_offset)
        return Mutant(file, first.lineno, edit.kind, start, source[start:end], edit.new)

    bodies = _Bodies(is_figure=bool(_FIGURES.search(file)))
    found = [mutant(edit) for edit in bodies.of(ast.parse(source).body, None)]
    return list({(one.start, one.old, one.new): one for one in found}.values())


def is_bug(source: str, mutant: Mutant) -> bool:
    """Return whether a source with a bug in it runs, and is another program."""
    try:
        return ast.dump(ast.parse(source)) != ast.dump(ast.parse(planted(source, mutant)))
    except SyntaxError:
        return False


class _Bodies:
    """Finds the bugs of statements and of what they contain."""

    def __init__(self, *, is_figure: bool) -> None:
        self._is_figure = is_figure

    def of(self, body: list[ast.stmt], function: ast.FunctionDef | None) -> Iterator[_Edit]:
        for statement in body:
            if isinstance(statement, (ast.FunctionDef, ast.AsyncFunctionDef)):
                if statement.name not in ("__repr__", "__str__"):
                    args = statement.args
                    for default in [*args.defaults, *filter(None, args.kw_defaults)]:
                        yield from _defaults(default)
                    yield from self.of(statement.body, statement)  # type: ignore[arg-type]
            elif isinstance(statement, ast.ClassDef):
                yield from self.of(statement.body, None)
                for field in statement.body:
                    if isinstance(field, ast.AnnAssign) and field.value is not None:
                        yield from _defaults(field.value)
            elif not _is_for_a_person(statement):
                yield from _of_statement(statement, function)
                for expression in _expressions(statement):
                    yield from self._in(expression)
                for block in _blocks(statement):
                    yield from self.of(block, function)

    def _in(self, expression: ast.AST) -> Iterator[_Edit]:
        if isinstance(expression, ast.JoinedStr):
            return
        if isinstance(expression, ast.Call) and _LOGS.fullmatch(ast.unparse(expression.func)):
            return
        yield from _of_expression(expression)
        for child in ast.iter_child_nodes(expression):
            name = child.arg if isinstance(child, ast.keyword) else None
            if name not in _NO_RESULT and not (name in _LOOKS and self._is_figure):
                yield from self._in(child)


def _is_for_a_person(statement: ast.stmt) -> bool:
    if isinstance(statement, (ast.Import, ast.ImportFrom, ast.Assert)):
        return True
    if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant):
        return True  # a docstring
    if isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Call):
        function = ast.unparse(statement.value.func)
        return bool(_LOGS.fullmatch(function) or _TITLES.fullmatch(function))
    if isinstance(statement, (ast.Assign, ast.AugAssign)):
        target = statement.targets[0] if isinstance(statement, ast.Assign) else statement.target
        return ast.unparse(target) in ("msg", "__all__")
    return isinstance(statement, ast.If) and (
        ast.unparse(statement.test) in ("TYPE_CHECKING", "__name__ == '__main__'")
    )


def _blocks(statement: ast.stmt) -> Iterator[list[ast.stmt]]:
    for name in ("body", "orelse", "finalbody"):
        yield getattr(statement, name, [])
    for handler in [*getattr(statement, "handlers", []), *getattr(statement, "cases", [])]:
        yield handler.body


def _expressions(statement: ast.stmt) -> Iterator[ast.expr]:
    for name in ("test", "value", "iter", "subject"):
        expression = getattr(statement, name, None)
        if isinstance(expression, ast.expr):
            yield expression
    targets = [getattr(statement, "target", None), *getattr(statement, "targets", [])]
    yield from (target for target in targets if isinstance(target, ast.Subscript))
    yield from (item.context_expr for item in getattr(statement, "items", []))
    yield from (case.guard for case in getattr(statement, "cases", []) if case.guard)


# -- statements ----------------------------------------------------------------------------------


def _of_statement(statement: ast.stmt, function: ast.FunctionDef | None) -> Iterator[_Edit]:
    match statement:
        case ast.If() | ast.While():
            yield _instead(statement.test, f"not ({ast.unparse(statement.test)})", "inverted")
        case ast.Match():
            for case in statement.cases:
                if not case.guard and not isinstance(case.pattern, ast.MatchAs):
                    yield _Edit(case.pattern, case.pattern, " if False", "case never met")
        case ast.With(items=[ast.withitem(optional_vars=None) as item]):
            if "lock" in ast.unparse(item.context_expr).lower():
                yield _Edit(statement, item.context_expr, "if True", "missing lock")
        case ast.Try():
            for handler in statement.handlers:
                if not isinstance(handler.body[0], ast.Pass):
                    first, last = handler.body[0], handler.body[-1]
                    yield _Edit(first, last, "pass", "exception swallowed")
            if statement.finalbody:
                first, last = statement.finalbody[0], statement.finalbody[-1]
                yield _Edit(first, last, "pass", "missing flush")
        case ast.Return(value=ast.expr()) if function is not None:
            yield from _of_return(statement, function)
        case ast.Raise():
            yield _instead(statement, "pass", "exception swallowed")
        case ast.Continue() | ast.Break():
            yield _instead(statement, "pass", "missing statement")
        case ast.Expr() if function is not None:
            yield _instead(statement, "pass", _kind_of_call(statement.value))
        case ast.AugAssign() | ast.Assign() if function is not None and _is_stale(
            statement, function
        ):
            yield _instead(statement, "pass", "stale value")


def _instead(node: ast.AST, new: str, kind: str) -> _Edit:
    return _Edit(node, node, new, "condition inverted" if kind == "inverted" else kind)


def _kind_of_call(value: ast.expr) -> str:
    name = value.func.attr if _is_method(value) else ""  # type: ignore[attr-defined]
    return "missing flush" if name in _FLUSHES else "missing call"


def _is_method(value: ast.expr) -> bool:
    return isinstance(value, ast.Call) and isinstance(value.func, ast.Attribute)


def _is_stale(statement: ast.Assign | ast.AugAssign, function: ast.FunctionDef) -> bool:
    """Return whether every assigned name has a value before the statement."""
    if function.name in ("__init__", "__post_init__", "__enter__"):
        return False
    if isinstance(statement, ast.AugAssign):
        return True
    known = {a.arg for a in [*function.args.args, *function.args.kwonlyargs]}
    for other in ast.walk(function):
        if getattr(other, "lineno", statement.lineno) < statement.lineno:
            known |= _stored(other)
    return _stored(ast.Tuple(list(statement.targets))) <= known


def _stored(tree: ast.AST) -> set[str]:
    names = (node for node in ast.walk(tree) if isinstance(node, ast.Name))
    if isinstance(tree, (ast.FunctionDef, ast.AsyncFunctionDef)):
        return set()
    return {node.id for node in names if isinstance(node.ctx, ast.Store)}


_STANDS_FOR = {"int": "{} + 1", "float": "2 * {} + 1", "bool": "not {}", "str": "''"}
_STANDS_FOR |= {"bytes": "b''"}


def _of_return(statement: ast.Return, function: ast.FunctionDef) -> Iterator[_Edit]:
    """Return another value of the same type, so that no type error gives the bug away."""
    assert statement.value is not None
    value = ast.unparse(statement.value)
    kind = ast.unparse(function.returns) if function.returns else ""
    args = [*function.args.args, *function.args.kwonlyargs]
    same = [a.arg for a in args if a.annotation and ast.unparse(a.annotation) == kind]
    other = "None"
    if kind in ("Step", "tuple[State, int, list[Action]]") and args[:1]:
        first = "state"
        if isinstance(statement.value, ast.Tuple):
            first = ast.unparse(statement.value.elts[0])
        other = f"({first}, {'0, ' if kind != 'Step' else ''}[])"
    elif same:
        other = same[0]
    elif kind.startswith(("list", "Iterator")):
        other = "[]"
    elif kind in _STANDS_FOR:
        other = _STANDS_FOR[kind].format(f"({value})")
    if other != value:
        yield _instead(statement.value, other, "another value returned")


# -- expressions ---------------------------------------------------------------------------------


def _of_expression(node: ast.AST) -> Iterator[_Edit]:
    match node:
        case ast.Compare():
            for i, op in enumerate(node.ops):
                for other, kind in _ORDER[type(op)].items():
                    changed = deepcopy(node)
                    changed.ops[i] = other()
                    yield _Edit(node, node, f"({ast.unparse(changed)})", kind)
        case ast.BoolOp():
            texts = [f"({ast.unparse(value)})" for value in node.values]
            word = " and " if isinstance(node.op, ast.Or) else " or "
            yield _Edit(node, node, f"({word.join(texts)})", "and/or")
            kept = " or " if isinstance(node.op, ast.Or) else " and "
            for i in range(len(texts)):
                rest = kept.join(texts[:i] + texts[i + 1 :])
                yield _Edit(node, node, f"({rest})", "operand dropped")
        case ast.UnaryOp(op=ast.Not()):
            yield _instead(node, f"({ast.unparse(node.operand)})", "inverted")
        case ast.UnaryOp(op=ast.USub()) if not isinstance(node.operand, ast.Constant):
            yield _instead(node, f"({ast.unparse(node.operand)})", "arithmetic")
        case ast.IfExp():
            yield _instead(node.test, f"(not {_in_brackets(node.test)})", "inverted")
        case ast.comprehension():
            for test in node.ifs:
                yield _instead(test, f"(not {_in_brackets(test)})", "inverted")
        case ast.BinOp():
            yield from _of_arithmetic(node)
        case ast.Call():
            yield from _of_call(node)
        case ast.Subscript(slice=ast.Constant(value=0)):
            yield _instead(node.slice, "-1", "neighbour")
        case ast.Subscript(slice=ast.UnaryOp(op=ast.USub(), operand=ast.Constant(value=1))):
            yield _instead(node.slice, "0", "neighbour")
        case ast.Slice():
            for bound in filter(None, (node.lower, node.upper)):
                if not isinstance(bound, ast.Constant):
                    yield _instead(bound, f"{ast.unparse(bound)} + 1", "off by one")
        case ast.Constant():
            yield from _of_constant(node)


def _in_brackets(node: ast.expr) -> str:
    return f"({ast.unparse(node)})"


def _of_arithmetic(node: ast.BinOp) -> Iterator[_Edit]:
    left, right = ast.unparse(node.left), ast.unparse(node.right)
    if isinstance(node.op, (ast.Mult, ast.Div)) and _UNIT.fullmatch(right):
        yield _instead(node, f"({left})", "unit")
    elif isinstance(node.op, ast.Mult) and _UNIT.fullmatch(left):
        yield _instead(node, f"({right})", "unit")
    elif type(node.op) in _ARITHMETIC and not any(
        isinstance(side, (ast.JoinedStr, ast.List, ast.Dict, ast.Set))
        or isinstance(getattr(side, "value", 0), (str, bytes))
        for side in (node.left, node.right)
    ):
        changed = ast.BinOp(node.left, _ARITHMETIC[type(node.op)](), node.right)
        yield _instead(node, f"({ast.unparse(changed)})", "arithmetic")


def _of_call(node: ast.Call) -> Iterator[_Edit]:
    name = ast.unparse(node.func).rpartition(".")[2]
    for one, two in pairwise(node.args):
        if name not in _SYMMETRIC and not any(isinstance(arg, ast.Starred) for arg in (one, two)):
            yield _Edit(one, two, f"{ast.unparse(two)}, {ast.unparse(one)}", "arguments swapped")
    for a, b in pairwise(node.keywords):
        if a.arg is not None and b.arg is not None:
            values = f"{a.arg}={ast.unparse(b.value)}, {b.arg}={ast.unparse(a.value)}"
            yield _Edit(a, b, values, "arguments swapped")
    if name in _NEIGHBOUR:
        changed = deepcopy(node)
        if isinstance(changed.func, ast.Attribute):
            changed.func.attr = _NEIGHBOUR[name]
        else:
            changed.func = ast.Name(_NEIGHBOUR[name])
        kind = "unit" if name in ("radians", "degrees") else "neighbour"
        yield _instead(node, ast.unparse(changed), kind)
    if name in ("deg2rad", "rad2deg") and len(node.args) == 1:
        yield _instead(node, _in_brackets(node.args[0]), "unit")
    if name in ("range", "arange") and not isinstance(node.args[-1], ast.Constant):
        yield _instead(node.args[-1], f"{_in_brackets(node.args[-1])} - 1", "off by one")
    if name in ("replace", "_replace"):
        for i, keyword in enumerate(node.keywords):
            if keyword.arg is not None:
                changed = deepcopy(node)
                del changed.keywords[i]
                yield _instead(node, ast.unparse(changed), "stale value")


def _of_constant(node: ast.Constant) -> Iterator[_Edit]:
    value = node.value
    if isinstance(value, bool):
        yield _instead(node, str(not value), "constant")
    elif isinstance(value, int) and value <= _SMALL:
        yield _instead(node, str(value + 1), "off by one")
        if value:
            yield _instead(node, str(value - 1), "off by one")
    elif isinstance(value, (int, float)) and not 0 < abs(value) < _MARGIN:
        yield _instead(node, str(2 * value + (value == 0)), "constant")


def _defaults(value: ast.expr) -> Iterator[_Edit]:
    """Return other values of a default: of a parameter, or of a field."""
    for node in ast.walk(value):
        if isinstance(node, ast.Constant):
            yield from (edit._replace(kind="wrong default") for edit in _of_constant(node))
