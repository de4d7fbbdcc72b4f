"""A model's generated functions as C: the equations of the C pass are then those of the Python one, line by line."""

from __future__ import annotations

import ast

from noiseid_cli.models.codegen import module_source
from noiseid_cli.models.equations import Model

_OPERATORS = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}
_COMPARISONS = {ast.Gt: ">", ast.Lt: "<", ast.GtE: ">=", ast.LtE: "<=", ast.Eq: "==", ast.NotEq: "!="}


def functions(model: Model, names: tuple[str, ...]) -> str:
    """C text of some functions of the model's generated module, all arguments as ``double *``."""
    columns = {"A": len(model.states), "B": len(model.noises), "H": len(model.states)}
    tree = ast.parse(module_source(model.equations()))
    wanted = {node.name: node for node in tree.body if isinstance(node, ast.FunctionDef)}
    return "\n".join(_function(wanted[name], columns) for name in names)


def _function(node: ast.FunctionDef, columns: dict[str, int]) -> str:
    arguments = ", ".join(f"double *restrict {a.arg}" for a in node.args.args)
    lines, known = [], set()
    for statement in node.body:
        if isinstance(statement, ast.For):
            lines.append(f"    {_zeros(statement)}")
            continue
        assert isinstance(statement, ast.Assign)
        target = statement.targets[0]
        name = _expression(target, columns)
        new = isinstance(target, ast.Name) and name not in known
        known.add(name)
        lines.append(f"    {'double ' if new else ''}{name} = {_expression(statement.value, columns)};")
    return f"static void {node.name}({arguments}) {{\n" + "\n".join(lines) + "\n}\n"


def _zeros(loop: ast.For) -> str:
    """The one kind of loop that is generated sets a matrix to zero, before its other entries are written."""
    match loop:
        case ast.For(
            iter=ast.Call(args=[ast.Constant(value=rows)]),
            body=[
                ast.For(
                    iter=ast.Call(args=[ast.Constant(value=columns)]),
                    body=[ast.Assign(targets=[ast.Subscript(value=ast.Name(id=name))])],
                )
            ],
        ):
            return f"memset({name}, 0, {rows * columns} * sizeof(double));"  # type: ignore[operator]
    raise NotImplementedError(ast.dump(loop))


def _expression(e: ast.expr, columns: dict[str, int]) -> str:  # noqa: PLR0911 - a line for each kind of node
    def text(part: ast.expr) -> str:
        return _expression(part, columns)

    match e:
        case ast.Name():
            return e.id
        case ast.Constant():
            return repr(float(e.value))  # type: ignore[arg-type]
        case ast.UnaryOp(op=ast.USub()):
            return f"(-{text(e.operand)})"
        case ast.BinOp(op=ast.Pow(), right=ast.Constant(value=int(power))):
            return "(" + "*".join([text(e.left)] * power) + ")"
        case ast.BinOp():
            return f"({text(e.left)} {_OPERATORS[type(e.op)]} {text(e.right)})"
        case ast.Compare():
            return f"({text(e.left)} {_COMPARISONS[type(e.ops[0])]} {text(e.comparators[0])})"
        case ast.BoolOp():
            joined = " && " if isinstance(e.op, ast.And) else " || "
            return "(" + joined.join(map(text, e.values)) + ")"
        case ast.IfExp():
            return f"({text(e.test)} ? {text(e.body)} : {text(e.orelse)})"
        case ast.Attribute(attr="nan"):
            return "NAN"
        case ast.Call(func=ast.Attribute(attr=name)):
            return f"{name}({', '.join(map(text, e.args))})"
        case ast.Subscript(value=ast.Name(id=name), slice=ast.Tuple(elts=[row, column])):
            return f"{name}[{row.value * columns[name] + column.value}]"  # type: ignore[attr-defined]
        case ast.Subscript(value=ast.Name(id=name), slice=ast.Constant(value=i)):
            return f"{name}[{i}]"
    raise NotImplementedError(ast.dump(e))
