"""Count lines of code, without docstrings, comments and blank lines; capability tests and `raise` statements.

Usage: python benchmarks/lines.py [FOLDER ...]

Each line with a token of code counts once. A capability test is a call of `hasattr`, or of `getattr` with a
default. Default: src/pinmobile, package by package.
"""

import ast
import io
import sys
import tokenize
from collections.abc import Sequence
from pathlib import Path

SOURCE = Path(__file__).parents[1] / "src" / "pinmobile"
EMPTY = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
    tokenize.ENCODING,
}


def code_lines(text: str) -> int:
    """Return the number of lines of code in a module's text."""
    lines = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in EMPTY:
            lines.update(range(token.start[0], token.end[0] + 1))
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            first = node.body[0] if node.body else None
            if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
                lines.difference_update(range(first.lineno, (first.end_lineno or first.lineno) + 1))
    return len(lines)


def capability_tests(tree: ast.AST) -> int:
    """Return the number of calls of `hasattr`, and of `getattr` with a default."""
    calls = (node for node in ast.walk(tree) if isinstance(node, ast.Call))
    names = [(each.func.id, len(each.args)) for each in calls if isinstance(each.func, ast.Name)]
    return sum(name == "hasattr" or (name == "getattr" and count == 3) for name, count in names)


def raises(tree: ast.AST) -> int:
    """Return the number of `raise` statements."""
    return sum(isinstance(node, ast.Raise) for node in ast.walk(tree))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the counts of each folder."""
    given = [Path(each) for each in (sys.argv[1:] if arguments is None else arguments)] or [SOURCE]
    for folder in given:
        texts = {path: path.read_text() for path in sorted(folder.rglob("*.py"))}
        counted = {path: code_lines(text) for path, text in texts.items()}
        parts: dict[str, list[int]] = {}
        for path, lines in counted.items():
            inside = path.relative_to(folder).parts
            parts.setdefault(inside[0] if len(inside) > 1 else "modules of its own", []).append(lines)
        for name, lines in parts.items():
            print(f"{name:20} {len(lines):4} files {sum(lines):6} lines of code")
        print(f"{'all':20} {len(counted):4} files {sum(counted.values()):6} lines of code")
        trees = [ast.parse(text) for text in texts.values()]
        print(f"{'':20} {sum(map(capability_tests, trees)):17} capability tests")
        print(f"{'':20} {sum(map(raises, trees)):17} raise statements")
    return 0


if __name__ == "__main__":
    sys.exit(main())
