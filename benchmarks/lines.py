"""How many lines of code the library has, without docstrings, comments and blank lines.

Usage: python benchmarks/lines.py [FOLDER ...]

Each line that carries a token of code counts once. By default of src/pinmobile, package by package.
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


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the lines of each folder."""
    given = [Path(each) for each in (sys.argv[1:] if arguments is None else arguments)] or [SOURCE]
    for folder in given:
        counted = {path: code_lines(path.read_text()) for path in sorted(folder.rglob("*.py"))}
        parts: dict[str, list[int]] = {}
        for path, lines in counted.items():
            inside = path.relative_to(folder).parts
            parts.setdefault(inside[0] if len(inside) > 1 else "modules of its own", []).append(lines)
        for name, lines in parts.items():
            print(f"{name:20} {len(lines):4} files {sum(lines):6} lines of code")
        print(f"{'all':20} {len(counted):4} files {sum(counted.values()):6} lines of code")
    return 0


if __name__ == "__main__":
    sys.exit(main())
