"""A module of scalar functions made faster to interpret: constants folded in, short loops unrolled.

The cycle function is written once, for reading and for the compiler of a study. Interpreted as it stands it
spends most of its time on looking up names, computing the same indices and calling one-line functions, all of
which is known before it runs. The folded functions do the same operations on the same numbers in the same
order, so that their results are the same bit for bit.
"""

import ast
import inspect
import types
from typing import Any

_LONGEST_LOOP = 16


def fold(module: types.ModuleType, *, inlined: str = "") -> dict[str, Any]:
    """The module's names, with its functions folded; its own functions where there is no source to read.

    - A name in capitals that stands for a number becomes the number.
    - ``for i in range(n)`` with such an n becomes its body n times.
    - A function of `math` is looked up here and not in every call.
    - A call of ``inlined``, ``name(value, low, high)``, becomes the comparison that it makes.

    Args:
        module: Functions of plain expressions without side effects but assignments.
        inlined: Name of its function that limits a value to a range, if it has one.
    """
    names = dict(vars(module))
    try:
        tree = ast.parse(inspect.getsource(module))
    except (OSError, TypeError):  # as `inspect` says both that there is no file and that it has no text
        return names
    folder = _Folder(names, inlined)
    functions = [folder.visit(node) for node in tree.body if isinstance(node, ast.FunctionDef)]
    folded = ast.fix_missing_locations(ast.Module(functions, []))
    exec(compile(folded, f"<folded {module.__name__}>", "exec"), names)  # noqa: S102  # our own source
    return names


class _Folder(ast.NodeTransformer):
    def __init__(self, names: dict[str, Any], inlined: str) -> None:
        self._names = names
        self._inlined = inlined
        self._numbers = {
            name: value for name, value in names.items() if name.isupper() and type(value) in (int, float)
        }
        self._unrolled: dict[str, int] = {}
        self._values = 0

    def visit_Name(self, node: ast.Name) -> ast.expr:
        number = self._unrolled.get(node.id, self._numbers.get(node.id))
        if number is None or not isinstance(node.ctx, ast.Load):
            return node
        return ast.Constant(number)

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        if not (isinstance(node.value, ast.Name) and node.value.id == "math"):
            return self.generic_visit(node)  # type: ignore[return-value]  # an expression stays one
        name = f"_math_{node.attr}"
        self._names[name] = getattr(self._names["math"], node.attr)
        return ast.Name(name, ast.Load())

    def visit_Call(self, node: ast.Call) -> ast.expr:
        self.generic_visit(node)
        if not (self._inlined and isinstance(node.func, ast.Name) and node.func.id == self._inlined):
            return node
        value, low, high = node.args
        self._values += 1
        name = f"_value_{self._values}"
        read = ast.Name(name, ast.Load())
        first = ast.NamedExpr(ast.Name(name, ast.Store()), value)
        above = ast.IfExp(ast.Compare(read, [ast.Gt()], [high]), high, read)
        return ast.IfExp(ast.Compare(first, [ast.Lt()], [low]), low, above)

    def visit_For(self, node: ast.For) -> ast.stmt | list[ast.stmt]:
        count = self._count(node)
        if count is None or not isinstance(node.target, ast.Name):
            return self.generic_visit(node)  # type: ignore[return-value]  # a statement stays one
        name, source = node.target.id, ast.unparse(ast.Module(node.body, []))
        statements: list[ast.stmt] = []
        for number in range(count):
            self._unrolled[name] = number
            statements += [self.visit(statement) for statement in ast.parse(source).body]
        del self._unrolled[name]
        return statements

    def _count(self, node: ast.For) -> int | None:
        """How often a loop runs, where that is known and small."""
        call = node.iter
        if not (isinstance(call, ast.Call) and isinstance(call.func, ast.Name) and call.func.id == "range"):
            return None
        limit = self.visit(call.args[0]) if len(call.args) == 1 else None
        if not isinstance(limit, ast.Constant) or not isinstance(limit.value, int):
            return None
        has_jump = any(isinstance(inner, (ast.Break, ast.Continue)) for inner in ast.walk(node))
        return None if has_jump or node.orelse or limit.value > _LONGEST_LOOP else limit.value
