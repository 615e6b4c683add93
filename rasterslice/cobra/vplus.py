"""Exactly the part of V+ that the player uses: read program text, make it callable.

Programs become Python functions that call a *host* for whatever touches the machine: motions, signals, files. A
keyword, function or form that is not listed here is an error: the player cannot drift into what nobody has checked.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any

from ..errors import UsageError

_TOKEN = re.compile(r'\s*(?:(?P<number>\d+\.?\d*|\.\d+)|(?P<name>\$?[A-Za-z][\w.]*)|(?P<text>"[^"]*")'
                    r"|(?P<format>/I0)|(?P<sign><>|<=|>=|==|[-+*/()\[\],:<>=]))")  # fmt: skip
_FUNCTIONS = {"ASC": "_asc", "VAL": "_val", "LEN": "len", "IOSTAT": "_host.iostat", "TRANS": "_trans"}
_WORDS = {"AND": " and ", "OR": " or "}
_COMPARE = {"<>": "!=", "<=": "<=", ">=": ">=", "==": "==", "<": "<", ">": ">"}
_RESERVED = {"AUTO", "CALL", "IF", "ELSE", "END", "FOR", "WHILE", "CASE", "VALUE", "ANY", "SET", "MOVES", "BREAK",
             "SPEED", "SIGNAL", "TOOL", "DELAY", "WAIT", "TYPE", "READ", "WRITE", "ATTACH", "DETACH", "FOPENR",
             "FOPENW", "FCLOSE", "REACTE", "DISABLE", "ACCEL", "TO", "DO", "OF", "THEN", "MMPS", "ALWAYS"}  # fmt: skip


class Program:
    """Programs of some files, callable by name on one host.

    Parameters
    ----------
    files : dict of str
        Program text by file name.
    host
        Has ``moves(x, y, z, roll)``, ``speed``, ``signal``, ``brk``, ``delay``, ``tool``, ``wait``, ``say``, ``accel``,
        ``attach``, ``detach``, ``open``, ``close``, ``read``, ``write``, ``iostat``.

    Raises
    ------
    UsageError
        ``file:line: what is not known``.
    """

    def __init__(self, files: dict[str, str], host: Any) -> None:
        self._space: dict[str, Any] = {
            "_host": host, "_asc": _asc, "_val": _val, "_trans": _trans, "_decode": _decode, "_Stop": Stop,
        }  # fmt: skip
        self.names: set[str] = set()
        source = []
        for name, content in files.items():
            source += _Reader(name, content, self.names).python()
        arrays = sorted(set(re.findall(r"\b(v_\w+)\[", "\n".join(source))))
        self._space.update({a: {} for a in arrays})
        exec(compile("\n".join(source), "<V+>", "exec"), self._space)  # only what _Reader spelled out

    def call(self, name: str) -> None:
        """Run a program to its end."""
        if name not in self.names:
            raise UsageError(f"no program {name}; the files hold {', '.join(sorted(self.names))}")
        try:
            self._space["p_" + _plain(name)]()
        except NameError as error:
            raise UsageError(f"V+: {error}: a variable is read before it is set") from None
        except KeyError as error:
            raise UsageError(f"V+: element {error} of an array is read before it is set") from None

    def value(self, name: str) -> Any:
        """Return a global variable or array."""
        return self._space["v_" + _plain(name)]


class Stop(Exception):
    """Raised by a host to end a program that would run for ever."""


class _Reader:
    """Turns the text of one file into Python, a statement a line."""

    def __init__(self, file: str, content: str, names: set[str]) -> None:
        self._file, self._lines, self._names = file, content.split("\n"), names
        self._out: list[str] = []
        self._blocks: list[str] = []
        self._local: set[str] = set()
        self._line = 0
        self._tokens: list[tuple[str, str]] = []
        self._depth = 0

    def python(self) -> list[str]:
        """Return the lines of Python."""
        inside = False
        for line, raw in enumerate(self._lines, 1):
            self._line = line
            text = _uncomment(raw.rstrip("\r")).strip()
            if not text.isascii():
                self._fail("not ASCII")
            if not text or text in ("\f", "\x1a"):
                continue
            if text.startswith(".PROGRAM"):
                if inside:
                    self._fail(".END is missing before this")
                self._begin(text)
                inside = True
            elif text.startswith(".END"):
                if not inside or self._blocks:
                    self._fail(".END does not fit")
                self._finish()
                inside = False
            elif inside:
                self._statement(text)
            else:
                self._fail(f"outside of a program: {text}")
        if inside:
            self._fail(".END is missing")
        return self._out

    def _begin(self, text: str) -> None:
        found = re.fullmatch(r"\.PROGRAM ([a-z][\w.]*)\(([\w.$, ]*)\)", text)
        if not found:
            self._fail(f"expected .PROGRAM name(parameters), got {text}")
        assert found
        if found[1] in self._names:
            self._fail(f"program {found[1]} is there twice")
        self._names.add(found[1])
        parameters = [p.strip() for p in found[2].split(",") if p.strip()]
        self._local = set(parameters)
        self._out.append(f"def p_{_plain(found[1])}({', '.join('v_' + _plain(p) for p in parameters)}):")
        self._depth, self._start, self._globals = 1, len(self._out), set[str]()
        self._emit("pass")

    def _finish(self) -> None:
        if self._globals:
            self._out.insert(self._start, f" global {', '.join(sorted(self._globals))}")

    def _emit(self, text: str) -> None:
        self._out.append(" " * self._depth + text)

    def _fail(self, what: str) -> None:
        raise UsageError(f"{self._file}:{self._line}: {what}")

    def _statement(self, text: str) -> None:
        tokens, at = [], 0
        while at < len(text):
            found = _TOKEN.match(text, at)
            if not found or found.end() == at:
                self._fail(f"not V+ as we write it: {text[at:]}")
            assert found
            tokens.append((str(found.lastgroup), found[str(found.lastgroup)]))
            at = found.end()
        self._tokens = tokens
        word = tokens[0][1]
        handler = getattr(self, "_s_" + word.lower(), None) if word.isupper() and tokens[0][0] == "name" else None
        if handler is not None and word in _RESERVED:
            self._next()
            handler()
        else:
            if word in _RESERVED or word.isupper():
                self._fail(f"keyword {word} is not known here")
            self._assign()
        if self._tokens:
            self._fail(f"not expected: {' '.join(t for _, t in self._tokens)}")

    # Tokens and expressions

    def _next(self) -> tuple[str, str]:
        if not self._tokens:
            self._fail("the line ends too early")
        return self._tokens.pop(0)

    def _peek(self) -> str:
        return self._tokens[0][1] if self._tokens else ""

    def _want(self, *words: str) -> None:
        for word in words:
            got = self._next()[1]
            if got != word:
                self._fail(f"expected {word}, got {got}")

    def _list(self) -> list[str]:
        items = [self._expression()]
        while self._peek() == ",":
            self._next()
            items.append(self._expression())
        return items

    def _expression(self) -> str:
        out = self._compare()
        while self._peek() in _WORDS:
            out += _WORDS[self._next()[1]] + self._compare()
        return out

    def _compare(self) -> str:
        out = self._sum()
        if self._peek() in _COMPARE:
            out = f"({out} {_COMPARE[self._next()[1]]} {self._sum()})"
        return out

    def _sum(self) -> str:
        out = self._product()
        while self._peek() in ("+", "-"):
            out = f"({out} {self._next()[1]} {self._product()})"
        return out

    def _product(self) -> str:
        out = self._atom()
        while self._peek() in ("*", "/"):
            out = f"({out} {self._next()[1]} {self._atom()})"
        return out

    def _atom(self) -> str:
        kind, word = self._next()
        if word == "-":
            return f"(-{self._atom()})"
        if word == "(":
            out = self._expression()
            self._want(")")
            return f"({out})"
        if kind == "number":
            return repr(float(word)) if "." in word else word
        if kind == "text":
            return repr(word[1:-1])
        if kind != "name":
            self._fail(f"not expected: {word}")
        if word == "$DECODE":
            return self._decode()
        if word == "$ENCODE":
            self._want("(", "/I0", ",")
            out = self._expression()
            self._want(")")
            return f"('%d' % ({out}))"
        if word in _FUNCTIONS:
            self._want("(")
            out = f"{_FUNCTIONS[word]}({', '.join(self._list())})"
            self._want(")")
            return out
        if word.isupper():
            self._fail(f"function {word} is not known here")
        return self._variable(word)

    def _variable(self, word: str) -> str:
        name = "v_" + _plain(word)
        if word not in self._local and self._peek() != "[":
            self._globals.add(name)
        if self._peek() == "[":
            self._next()
            index = self._expression()
            self._want("]")
            return f"{name}[{index}]"
        return name

    def _decode(self) -> str:
        self._want("(")
        name = self._variable(self._next()[1])
        self._want(",")
        mark = self._expression()
        self._want(",")
        mode = self._next()[1]
        self._want(")")
        return f"_decode({name}, {mark}, {mode}, {name})"

    def _assign(self) -> None:
        target = self._variable(self._next()[1])
        self._want("=")
        value = self._expression()
        if value.startswith("_decode("):  # takes from its first argument, too
            source = value[len("_decode(") :].partition(",")[0]
            self._emit(f"{target}, {source} = {value}")
        else:
            self._emit(f"{target} = {value}")

    # Statements

    def _s_auto(self) -> None:
        while self._tokens:
            word = self._next()[1]
            self._local.add(word)
            if self._tokens:
                self._want(",")

    def _s_call(self) -> None:
        name = self._next()[1]
        self._want("(")
        items = [] if self._peek() == ")" else self._list()
        self._want(")")
        self._emit(f"p_{_plain(name)}({', '.join(items)})")

    def _s_if(self) -> None:
        self._emit(f"if {self._expression()}:")
        self._want("THEN")
        self._open("IF")

    def _s_else(self) -> None:
        if not self._blocks or self._blocks[-1] != "IF":
            self._fail("ELSE without IF")
        self._out.append(" " * (self._depth - 1) + "else:")
        self._emit("pass")

    def _s_while(self) -> None:
        self._emit(f"while {self._expression()}:")
        self._want("DO")
        self._open("WHILE")

    def _s_for(self) -> None:
        name = self._variable(self._next()[1])
        self._want("=")
        start = self._expression()
        self._want("TO")
        self._emit(f"for {name} in range(int({start}), int({self._expression()}) + 1):")
        self._open("FOR")

    def _s_case(self) -> None:
        self._emit(f"_case{len(self._blocks)} = {self._expression()}")
        self._want("OF")
        self._emit("if False:")
        self._open("CASE")

    def _s_value(self) -> None:
        if not self._blocks or self._blocks[-1] != "CASE":
            self._fail("VALUE without CASE")
        items = self._list()
        self._want(":")
        self._out.append(" " * (self._depth - 1) + f"elif _case{len(self._blocks) - 1} in ({', '.join(items)},):")
        self._emit("pass")

    def _s_any(self) -> None:
        if not self._blocks or self._blocks[-1] != "CASE":
            self._fail("ANY without CASE")
        self._out.append(" " * (self._depth - 1) + "else:")
        self._emit("pass")

    def _open(self, what: str) -> None:
        self._blocks.append(what)
        self._depth += 1
        self._emit("pass")

    def _s_end(self) -> None:
        if not self._blocks:
            self._fail("END without a beginning")
        self._blocks.pop()
        self._depth -= 1

    def _s_set(self) -> None:
        self._assign()

    def _s_moves(self) -> None:
        base = self._variable(self._next()[1])
        self._want(":")
        self._emit(f"_host.moves({base}, {self._expression()})")

    def _s_speed(self) -> None:
        self._emit(f"_host.speed({self._expression()})")
        self._want("MMPS", "ALWAYS")

    def _s_break(self) -> None:
        self._emit("_host.brk()")

    def _s_signal(self) -> None:
        self._emit(f"_host.signal({', '.join(self._list())})")

    def _s_tool(self) -> None:
        self._emit(f"_host.tool({self._expression()})")

    def _s_delay(self) -> None:
        self._emit(f"_host.delay({self._expression()})")

    def _s_wait(self) -> None:
        name = self._variable(self._next()[1])
        self._emit(f"{name} = _host.wait({name})")

    def _s_type(self) -> None:
        self._emit(f"_host.say({', '.join(self._list())})")

    def _s_accel(self) -> None:
        self._emit(f"_host.accel({', '.join(self._list())})")

    def _s_disable(self) -> None:
        self._want("SCALE.ACCEL")

    def _s_reacte(self) -> None:
        self._next()

    def _unit(self) -> str:
        self._want("(")
        out = self._variable(self._next()[1])
        self._want(")")
        return out

    def _s_attach(self) -> None:
        self._want("(")
        if self._peek() == ")":
            self._next()
            return
        unit = self._variable(self._next()[1])
        self._want(",", "4", ")")
        self._emit(f"{unit} = _host.attach({self._expression()})")

    def _s_detach(self) -> None:
        self._emit(f"_host.detach({self._unit()})")

    def _s_fopenr(self) -> None:
        self._emit(f"_host.open({self._unit()}, {self._expression()}, False)")

    def _s_fopenw(self) -> None:
        self._emit(f"_host.open({self._unit()}, {self._expression()}, True)")

    def _s_fclose(self) -> None:
        self._emit(f"_host.close({self._unit()})")

    def _s_read(self) -> None:
        unit = self._unit()
        self._emit(f"{self._variable(self._next()[1])} = _host.read({unit})")

    def _s_write(self) -> None:
        unit = self._unit()
        self._emit(f"_host.write({unit}, ''.join(({', '.join(self._list())},)))")


def load(files: dict[str, str]) -> Callable[[Any], Program]:
    """Return what makes a program on a host from files."""
    return lambda host: Program(files, host)


def _plain(name: str) -> str:
    return name.replace("$", "s_").replace(".", "__")


def _uncomment(line: str) -> str:
    quoted = False
    for i, c in enumerate(line):
        quoted ^= c == '"'
        if c == ";" and not quoted:
            return line[:i]
    return line


def _asc(text: str, at: int = 1) -> int:
    return ord(text[at - 1]) if len(text) >= at else -1


def _val(text: str) -> float:
    """Return the number that a string begins with, else 0, as V+ does."""
    try:
        value = float(text)
        return value if math.isfinite(value) else 0.0
    except ValueError:
        found = re.match(r"\s*[-+]?(\d+\.?\d*|\.\d+)", text)
        return float(found[0]) if found else 0.0


def _trans(*values: float) -> tuple[float, ...]:
    return values


def _decode(text: str, mark: str, mode: int, _: str) -> tuple[str, str]:
    """Return (taken, left): up to the mark, or the marks themselves."""
    if mode == 0:
        at = text.find(mark)
        return (text, "") if at < 0 else (text[:at], text[at:])
    left = text.lstrip(mark)
    return text[: len(text) - len(left)], left
