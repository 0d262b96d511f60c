"""The bugs that can be planted in a module: one small change of its syntax tree each.

What only a person reads is left alone: texts, annotations, docstrings.
"""

from __future__ import annotations

import ast
import copy
from collections.abc import Callable, Iterator
from itertools import islice
from typing import NamedTuple

_ORDER: dict[type[ast.cmpop], list[type[ast.cmpop]]] = {
    ast.Lt: [ast.LtE, ast.GtE],
    ast.LtE: [ast.Lt, ast.Gt],
    ast.Gt: [ast.GtE, ast.LtE],
    ast.GtE: [ast.Gt, ast.Lt],
    ast.Eq: [ast.NotEq],
    ast.NotEq: [ast.Eq],
    ast.Is: [ast.IsNot],
    ast.IsNot: [ast.Is],
    ast.In: [ast.NotIn],
    ast.NotIn: [ast.In],
}
_ARITHMETIC: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.FloorDiv,
    ast.FloorDiv: ast.Mult,
    ast.Div: ast.Mult,
    ast.Mod: ast.FloorDiv,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}


class Site(NamedTuple):
    """Where a bug can be planted."""

    module: str
    number: int
    """Of the bugs of its module; the same as long as the module is."""
    line: int
    kind: str

    @property
    def name(self) -> str:
        """Return what it is called on the command line."""
        return f"{self.module.removeprefix('armrig_daemon.')}:{self.number}"


class Bug(NamedTuple):
    """A bug that was planted."""

    before: str
    """The statement as it was, one line of it."""
    after: str
    tree: ast.Module


class _Change(NamedTuple):
    """A node to be changed in place, within what shows it to a person."""

    node: ast.AST
    shown: ast.AST
    kind: str
    apply: Callable[[ast.AST], None]


def sites(module: str, source: str) -> list[Site]:
    """Return where bugs can be planted in a module."""
    return [
        Site(module, number, _line(change), change.kind)
        for number, change in enumerate(_changes(ast.parse(source)))
    ]


def planted(source: str, number: int) -> Bug:
    """Return a module's syntax tree with one bug in it."""
    tree = ast.parse(source)
    change = next(islice(_changes(tree), number, None))
    before = _shown(change.shown)
    change.apply(change.node)
    ast.fix_missing_locations(tree)
    return Bug(before, _shown(change.shown), tree)


def _line(change: _Change) -> int:
    at = change.node.pattern if isinstance(change.node, ast.match_case) else change.node
    return int(getattr(at, "lineno", 1))


def _shown(node: ast.AST) -> str:
    """Return the head of a statement as one line."""
    return next((line.strip() for line in ast.unparse(node).splitlines() if line), "")


def _changes(tree: ast.Module) -> Iterator[_Change]:
    yield from _in_body(tree.body, None)


def _in_body(body: list[ast.stmt], function: ast.FunctionDef | None) -> Iterator[_Change]:
    for at, statement in enumerate(body):
        if isinstance(statement, ast.FunctionDef):
            for default in [*statement.args.defaults, *filter(None, statement.args.kw_defaults)]:
                yield from _in_expression(default, default)
            yield from _in_body(statement.body, statement)
            continue
        if isinstance(statement, ast.ClassDef):
            yield from _in_body(statement.body, None)
            continue
        if isinstance(statement, (ast.Import, ast.ImportFrom)) or _is_docstring(statement):
            continue
        yield from _of_statement(statement, function, body, at)
        for expression in _expressions(statement):
            yield from _in_expression(expression, statement)
        for block in _blocks(statement):
            yield from _in_body(block, function)


def _is_docstring(statement: ast.stmt) -> bool:
    return isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)


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
    if isinstance(statement, ast.Match):
        yield from (case.guard for case in statement.cases if case.guard)


# -- statements ----------------------------------------------------------------------------------


def _of_statement(
    statement: ast.stmt, function: ast.FunctionDef | None, body: list[ast.stmt], at: int
) -> Iterator[_Change]:
    if isinstance(statement, (ast.If, ast.While)):
        yield _Change(statement, statement, "condition negated", _negate_test)
    if isinstance(statement, ast.Match):
        for case in statement.cases:
            if not case.guard and not isinstance(case.pattern, ast.MatchAs):
                yield _Change(case, case, "case never met", _never_meet)
    if function is None:
        return
    if isinstance(statement, ast.Return) and statement.value is not None:
        yield from _of_return(statement, function)
    elif _can_go(statement, function):
        yield _Change(statement, statement, "statement deleted", _delete)


def _can_go(statement: ast.stmt, function: ast.FunctionDef) -> bool:
    """Return whether the function still runs without a statement."""
    if isinstance(statement, (ast.AugAssign, ast.Expr, ast.Continue, ast.Break)):
        return True
    if isinstance(statement, ast.Raise):
        return True
    if not isinstance(statement, ast.Assign):
        return False
    args = function.args
    known = {a.arg for a in [*args.args, *args.kwonlyargs]}
    for other in ast.walk(function):
        if isinstance(other, (ast.Assign, ast.AnnAssign)) and other.lineno < statement.lineno:
            for target in ast.walk(other):
                if isinstance(target, ast.Name) and isinstance(target.ctx, ast.Store):
                    known.add(target.id)
    stored = [
        n.id
        for target in statement.targets
        for n in ast.walk(target)
        if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)
    ]
    return all(name in known for name in stored)


def _delete(node: ast.AST) -> None:
    """Make a statement say nothing, in place."""
    node.__class__ = ast.Pass
    for name in ("value", "targets", "target", "op", "exc", "cause", "type_comment"):
        node.__dict__.pop(name, None)


def _negate_test(node: ast.AST) -> None:
    assert isinstance(node, (ast.If, ast.While))
    node.test = ast.UnaryOp(ast.Not(), node.test)


def _never_meet(node: ast.AST) -> None:
    assert isinstance(node, ast.match_case)
    node.guard = ast.Constant(False)


_STANDS_FOR = {"int": "{} + 1", "float": "{} + 1", "bool": "not {}", "str": "''", "bytes": "b''"}


def _of_return(statement: ast.Return, function: ast.FunctionDef) -> Iterator[_Change]:
    """Offer another value of the same type, so that a type error does not give the bug away."""
    assert statement.value is not None
    value = ast.unparse(statement.value)
    kind = ast.unparse(function.returns) if function.returns else ""
    names = [a.arg for a in function.args.args]
    if kind in ("Step", "tuple[State, int, list[Action]]") and "state" in names:
        middle = "0, " if kind != "Step" else ""
        others = [f"(state, {middle}[])"]
        if isinstance(statement.value, ast.Tuple):
            first = ast.unparse(statement.value.elts[0])
            others = [f"({first}, {middle}[])"] if value != f"({first}, {middle}[])" else []
    elif kind == "State" and "state" in names:
        others = ["state"]
    elif kind.startswith(("list", "Iterator")):
        others = ["[]"]
    elif kind in _STANDS_FOR:
        others = [_STANDS_FOR[kind].format(f"({value})")]
    else:
        others = ["None"]
    for other in others:
        if ast.unparse(ast.parse(other, mode="eval").body) != value:
            yield _Change(statement, statement, "another value returned", _returns(other))


def _returns(other: str) -> Callable[[ast.AST], None]:
    def apply(node: ast.AST) -> None:
        assert isinstance(node, ast.Return)
        node.value = ast.parse(other, mode="eval").body

    return apply


# -- expressions ---------------------------------------------------------------------------------


def _in_expression(expression: ast.expr, shown: ast.AST) -> Iterator[_Change]:
    for node in ast.walk(expression):
        if isinstance(node, ast.Compare):
            for i, op in enumerate(node.ops):
                for other in _ORDER[type(op)]:
                    yield _Change(node, shown, "comparison", _compares(i, other))
        elif isinstance(node, ast.BoolOp):
            yield _Change(node, shown, "and/or", _swap_and_or)
            for i in range(len(node.values)):
                yield _Change(node, shown, "operand dropped", _drops_operand(i))
        elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            yield _Change(node, shown, "not dropped", _drop_not)
        elif isinstance(node, ast.IfExp):
            yield _Change(node, shown, "condition negated", _negate_choice)
        elif isinstance(node, ast.BinOp) and type(node.op) in _ARITHMETIC:
            if not isinstance(node.left, (ast.Constant, ast.JoinedStr)) or not isinstance(
                getattr(node.left, "value", 0), (str, list)
            ):
                yield _Change(node, shown, "arithmetic", _computes(_ARITHMETIC[type(node.op)]))
        elif isinstance(node, ast.Call):
            for i, keyword in enumerate(node.keywords):
                if keyword.arg is not None and _is_replace(node):
                    yield _Change(node, shown, "field not set", _drops_keyword(i))
        elif isinstance(node, ast.Constant):
            yield from _of_constant(node, shown)


def _of_constant(node: ast.Constant, shown: ast.AST) -> Iterator[_Change]:
    value = node.value
    if isinstance(value, bool):
        yield _Change(node, shown, "constant", _becomes(not value))
    elif isinstance(value, int):
        yield _Change(node, shown, "constant", _becomes(value + 1))
        if value:
            yield _Change(node, shown, "constant", _becomes(value - 1))
    elif isinstance(value, float):
        yield _Change(node, shown, "constant", _becomes(2 * value + (value == 0)))


def _is_replace(call: ast.Call) -> bool:
    name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
    return name in ("replace", "_replace")


def _compares(i: int, other: type[ast.cmpop]) -> Callable[[ast.AST], None]:
    def apply(node: ast.AST) -> None:
        assert isinstance(node, ast.Compare)
        node.ops[i] = other()

    return apply


def _swap_and_or(node: ast.AST) -> None:
    assert isinstance(node, ast.BoolOp)
    node.op = ast.And() if isinstance(node.op, ast.Or) else ast.Or()


def _drops_operand(i: int) -> Callable[[ast.AST], None]:
    def apply(node: ast.AST) -> None:
        assert isinstance(node, ast.BoolOp)
        del node.values[i]
        if len(node.values) == 1:
            node.values.append(copy.deepcopy(node.values[0]))  # a BoolOp of one is not compiled

    return apply


def _drop_not(node: ast.AST) -> None:
    assert isinstance(node, ast.UnaryOp)
    node.operand = ast.UnaryOp(ast.Not(), node.operand)


def _negate_choice(node: ast.AST) -> None:
    assert isinstance(node, ast.IfExp)
    node.test = ast.UnaryOp(ast.Not(), node.test)


def _computes(other: type[ast.operator]) -> Callable[[ast.AST], None]:
    def apply(node: ast.AST) -> None:
        assert isinstance(node, ast.BinOp)
        node.op = other()

    return apply


def _drops_keyword(i: int) -> Callable[[ast.AST], None]:
    def apply(node: ast.AST) -> None:
        assert isinstance(node, ast.Call)
        del node.keywords[i]

    return apply


def _becomes(value: object) -> Callable[[ast.AST], None]:
    def apply(node: ast.AST) -> None:
        assert isinstance(node, ast.Constant)
        node.value = value  # type: ignore[assignment]

    return apply
