"""The text of V+ programs: lines, tokens and expressions, turned into Python (see `vplus`)."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from typing import NoReturn

from ..errors import UsageError

_TOKEN = re.compile(r'\s*(?:(?P<number>\d+\.?\d*|\.\d+)|(?P<name>[$#]?[A-Za-z][\w.]*)|(?P<text>"[^"]*")'
                    r"|(?P<format>/I0)|(?P<sign><>|<=|>=|==|[-+*/()\[\],:<>=]))")  # fmt: skip
_FUNCTIONS = {
    "ASC": "_asc", "VAL": "_val", "LEN": "len", "IOSTAT": "_desk.iostat", "TRANS": "_trans", "#PPOINT": "_trans",
    "DZ": "_dz", "TASK": "_desk.task",
}  # fmt: skip
_WORDS = {"AND": " and ", "OR": " or "}
_COMPARE = {"<>": "!=", "<=": "<=", ">=": ">=", "==": "==", "<": "<", ">": ">"}


class Reader:
    """Turns the text of one file into Python, a statement a line.

    Parameters
    ----------
    file, content : str
        Name for messages, and text.
    names : set of str
        Programs so far; grows.
    words : mapping
        What each keyword does with the tokens that follow it.
    """

    def __init__(
        self, file: str, content: str, names: set[str], words: Mapping[str, Callable[[Reader], None]]
    ) -> None:
        self._file, self._lines, self._names, self._words = file, content.split("\n"), names, words
        self.out: list[str] = []
        self.blocks: list[str] = []
        self.local: set[str] = set()
        self._line = 0
        self.tokens: list[tuple[str, str]] = []
        self.depth = 0

    def python(self) -> list[str]:
        """Return the lines of Python."""
        inside = False
        for line, raw in enumerate(self._lines, 1):
            self._line = line
            text = _uncomment(raw.rstrip("\r")).strip()
            if not text.isascii():
                self.fail("not ASCII")
            if not text or text in ("\f", "\x1a"):
                continue
            if text.startswith(".PROGRAM"):
                if inside:
                    self.fail(".END is missing before this")
                self._begin(text)
                inside = True
            elif text.startswith(".END"):
                if not inside or self.blocks:
                    self.fail(".END does not fit")
                self._finish()
                inside = False
            elif inside:
                self._statement(text)
            else:
                self.fail(f"outside of a program: {text}")
        if inside:
            self.fail(".END is missing")
        return self.out

    def _begin(self, text: str) -> None:
        found = re.fullmatch(r"\.PROGRAM ([a-z][\w.]*)\(([\w.$, ]*)\)", text)
        if not found:
            self.fail(f"expected .PROGRAM name(parameters), got {text}")
        if found[1] in self._names:
            self.fail(f"program {found[1]} is there twice")
        self._names.add(found[1])
        parameters = [p.strip() for p in found[2].split(",") if p.strip()]
        self.local = set(parameters)
        self.out.append(f"def p_{plain(found[1])}({', '.join('v_' + plain(p) for p in parameters)}):")
        self.depth, self._start, self._globals = 1, len(self.out), set[str]()
        self.emit("pass")

    def _finish(self) -> None:
        if self._globals:
            self.out.insert(self._start, f" global {', '.join(sorted(self._globals))}")

    def emit(self, text: str) -> None:
        """Add a line of Python."""
        self.out.append(" " * self.depth + text)

    @property
    def place(self) -> str:
        """File and line that is being read."""
        return f"{self._file}:{self._line}"

    def fail(self, what: str) -> NoReturn:
        """Say what is wrong in this line."""
        raise UsageError(f"{self.place}: {what}")

    def _statement(self, text: str) -> None:
        tokens: list[tuple[str, str]] = []
        at = 0
        while at < len(text):
            found = _TOKEN.match(text, at)
            if not found or found.end() == at:
                self.fail(f"not V+ as we write it: {text[at:]}")
            tokens.append((str(found.lastgroup), found[str(found.lastgroup)]))
            at = found.end()
        self.tokens = tokens
        word = tokens[0][1]
        if word in self._words:
            self.next()
            self._words[word](self)
        else:
            if word.isupper():
                self.fail(f"keyword {word} is not known here")
            self.assign()
        if self.tokens:
            self.fail(f"not expected: {' '.join(t for _, t in self.tokens)}")

    # Tokens and expressions

    def next(self) -> tuple[str, str]:
        """Take a token: its kind and text."""
        if not self.tokens:
            self.fail("the line ends too early")
        return self.tokens.pop(0)

    def peek(self) -> str:
        """Return the text of the next token, or nothing."""
        return self.tokens[0][1] if self.tokens else ""

    def want(self, *words: str) -> None:
        """Take tokens that must be these."""
        for word in words:
            got = self.next()[1]
            if got != word:
                self.fail(f"expected {word}, got {got}")

    def items(self) -> list[str]:
        """Take expressions between commas."""
        items = [self.expression()]
        while self.peek() == ",":
            self.next()
            items.append(self.expression())
        return items

    def expression(self) -> str:
        """Take an expression; return it in Python."""
        out = self._compare()
        while self.peek() in _WORDS:
            out += _WORDS[self.next()[1]] + self._compare()
        return out

    def _compare(self) -> str:
        out = self._sum()
        if self.peek() in _COMPARE:
            out = f"({out} {_COMPARE[self.next()[1]]} {self._sum()})"
        return out

    def _sum(self) -> str:
        out = self._product()
        while self.peek() in ("+", "-"):
            out = f"({out} {self.next()[1]} {self._product()})"
        return out

    def _product(self) -> str:
        out = self._atom()
        while self.peek() in ("*", "/"):
            out = f"({out} {self.next()[1]} {self._atom()})"
        return out

    def _atom(self) -> str:
        kind, word = self.next()
        if word == "-":
            return f"(-{self._atom()})"
        if word == "(":
            out = self.expression()
            self.want(")")
            return f"({out})"
        if kind == "number":
            return repr(float(word)) if "." in word else word
        if kind == "text":
            return repr(word[1:-1])
        if kind != "name":
            self.fail(f"not expected: {word}")
        if word == "$DECODE":
            return self._decode()
        if word == "$ENCODE":
            self.want("(", "/I0", ",")
            out = self.expression()
            self.want(")")
            return f"('%d' % ({out}))"
        if word in _FUNCTIONS:
            self.want("(")
            out = f"{_FUNCTIONS[word]}({', '.join(self.items())})"
            self.want(")")
            return out
        if word.isupper():
            self.fail(f"function {word} is not known here")
        return self.variable(word)

    def variable(self, word: str) -> str:
        """Return a variable or an element of an array in Python."""
        name = "v_" + plain(word)
        if word not in self.local and self.peek() != "[":
            self._globals.add(name)
        if self.peek() == "[":
            self.next()
            index = self.expression()
            self.want("]")
            return f"{name}[{index}]"
        return name

    def _decode(self) -> str:
        self.want("(")
        name = self.variable(self.next()[1])
        self.want(",")
        mark = self.expression()
        self.want(",")
        mode = self.next()[1]
        self.want(")")
        return f"_decode({name}, {mark}, {mode}, {name})"

    def assign(self) -> None:
        """Take an assignment."""
        target = self.variable(self.next()[1])
        self.want("=")
        value = self.expression()
        if value.startswith("_decode("):  # takes from its first argument, too
            source = value[len("_decode(") :].partition(",")[0]
            self.emit(f"{target}, {source} = {value}")
        else:
            self.emit(f"{target} = {value}")


def plain(name: str) -> str:
    """Return a name of V+ as part of a name of Python."""
    return name.replace("$", "s_").replace("#", "j_").replace(".", "__")


def _uncomment(line: str) -> str:
    quoted = False
    for i, c in enumerate(line):
        quoted ^= c == '"'
        if c == ";" and not quoted:
            return line[:i]
    return line
