"""The statements of V+ that the player uses: each takes what follows its keyword and adds lines of Python."""

from __future__ import annotations

from collections.abc import Callable

from .reader import Reader, plain


def _auto(r: Reader) -> None:
    while r.tokens:
        word = r.next()[1]
        r.local.add(word)
        if r.tokens:
            r.want(",")


def _call(r: Reader) -> None:
    name = r.next()[1]
    r.want("(")
    items = [] if r.peek() == ")" else r.items()
    r.want(")")
    r.emit(f"p_{plain(name)}({', '.join(items)})")


def _if(r: Reader) -> None:
    r.emit(f"if {r.expression()}:")
    r.want("THEN")
    _begin(r, "IF")


def _else(r: Reader) -> None:
    if not r.blocks or r.blocks[-1] != "IF":
        r.fail("ELSE without IF")
    r.out.append(" " * (r.depth - 1) + "else:")
    r.emit("pass")


def _while(r: Reader) -> None:
    r.emit(f"while {r.expression()}:")
    r.want("DO")
    _begin(r, "WHILE", f"_step({r.place!r})")


def _for(r: Reader) -> None:
    name = r.variable(r.next()[1])
    r.want("=")
    start = r.expression()
    r.want("TO")
    r.emit(f"for {name} in range(int({start}), int({r.expression()}) + 1):")
    _begin(r, "FOR", f"_step({r.place!r})")


def _case(r: Reader) -> None:
    r.emit(f"_case{len(r.blocks)} = {r.expression()}")
    r.want("OF")
    r.emit("if False:")
    _begin(r, "CASE")


def _value(r: Reader) -> None:
    if not r.blocks or r.blocks[-1] != "CASE":
        r.fail("VALUE without CASE")
    items = r.items()
    r.want(":")
    r.out.append(" " * (r.depth - 1) + f"elif _case{len(r.blocks) - 1} in ({', '.join(items)},):")
    r.emit("pass")


def _any(r: Reader) -> None:
    if not r.blocks or r.blocks[-1] != "CASE":
        r.fail("ANY without CASE")
    r.out.append(" " * (r.depth - 1) + "else:")
    r.emit("pass")


def _begin(r: Reader, what: str, first: str = "pass") -> None:
    r.blocks.append(what)
    r.depth += 1
    r.emit(first)


def _end(r: Reader) -> None:
    if not r.blocks:
        r.fail("END without a beginning")
    r.blocks.pop()
    r.depth -= 1


def _set(r: Reader) -> None:
    r.assign()


def _moves(r: Reader) -> None:
    base = r.variable(r.next()[1])
    r.want(":")
    r.emit(f"_host.moves({base}, {r.expression()})")


def _move(r: Reader) -> None:
    if r.peek().startswith("#"):
        r.emit(f"_host.move_joints({r.variable(r.next()[1])})")
        return
    base = r.variable(r.next()[1])
    r.want(":")
    r.emit(f"_host.move({base}, {r.expression()})")


def _here(r: Reader) -> None:
    word = r.next()[1]
    r.emit(f"{r.variable(word)} = _host.{'joints' if word.startswith('#') else 'here'}()")


def _decompose(r: Reader) -> None:
    name, _, index = r.variable(r.next()[1])[:-1].partition("[")
    r.want("=")
    r.emit(f"for _i, _v in enumerate({r.expression()}): {name}[{index} + _i] = _v")


def _speed(r: Reader) -> None:
    value = r.expression()
    if r.peek() == "ALWAYS":
        r.emit(f"_host.percent({value})")
    else:
        r.emit(f"_host.speed({value})")
        r.want("MMPS")
    r.want("ALWAYS")


def _break(r: Reader) -> None:
    r.emit("_host.brk()")


def _signal(r: Reader) -> None:
    r.emit(f"_host.signal({', '.join(r.items())})")


def _tool(r: Reader) -> None:
    r.emit(f"_host.tool({r.expression()})")


def _delay(r: Reader) -> None:
    r.emit(f"_host.delay({r.expression()})")


def _base(r: Reader) -> None:
    r.want("0", ",", "0", ",", "0", ",", "0")


def _side(r: Reader) -> None:
    r.emit("_host.side()")


def _brake(r: Reader) -> None:
    r.emit("_host.brake()")


def _halt(r: Reader) -> None:
    r.emit("raise _Halt")


def _return(r: Reader) -> None:
    r.emit("return")


def _wait_event(r: Reader) -> None:
    r.want(",")
    r.emit(f"_desk.pause({r.expression()})")


def _wait(r: Reader) -> None:
    name = r.variable(r.next()[1])
    r.emit(f"{name} = _desk.wait({name})")


def _type(r: Reader) -> None:
    r.emit(f"_desk.say({', '.join(r.items())})")


def _accel(r: Reader) -> None:
    r.emit(f"_host.accel({', '.join(r.items())})")


def _disable(r: Reader) -> None:
    r.want("SCALE.ACCEL")


def _reacte(r: Reader) -> None:
    r.emit(f"_host.reacte(p_{plain(r.next()[1])})")


def _unit(r: Reader) -> str:
    r.want("(")
    out = r.variable(r.next()[1])
    r.want(")")
    return out


def _attach(r: Reader) -> None:
    r.want("(")
    if r.peek() == ")":
        r.next()
        return
    unit = r.variable(r.next()[1])
    r.want(",", "4", ")")
    r.emit(f"{unit} = _desk.attach({r.expression()})")


def _detach(r: Reader) -> None:
    r.emit(f"_desk.detach({_unit(r)})")


def _fopenr(r: Reader) -> None:
    r.emit(f"_desk.open({_unit(r)}, {r.expression()}, False)")


def _fopenw(r: Reader) -> None:
    r.emit(f"_desk.open({_unit(r)}, {r.expression()}, True)")


def _fclose(r: Reader) -> None:
    r.emit(f"_desk.close({_unit(r)})")


def _read(r: Reader) -> None:
    unit = _unit(r)
    r.emit(f"{r.variable(r.next()[1])} = _desk.read({unit})")


def _write(r: Reader) -> None:
    unit = _unit(r)
    r.emit(f"_desk.write({unit}, ''.join(({', '.join(r.items())},)))")


#: What each keyword does with what follows it.
WORDS: dict[str, Callable[[Reader], None]] = {
    "AUTO": _auto,
    "CALL": _call,
    "IF": _if,
    "ELSE": _else,
    "WHILE": _while,
    "FOR": _for,
    "CASE": _case,
    "VALUE": _value,
    "ANY": _any,
    "END": _end,
    "SET": _set,
    "MOVES": _moves,
    "MOVE": _move,
    "HERE": _here,
    "DECOMPOSE": _decompose,
    "BASE": _base,
    "LEFTY": _side,
    "RIGHTY": _side,
    "BRAKE": _brake,
    "HALT": _halt,
    "RETURN": _return,
    "WAIT.EVENT": _wait_event,
    "SPEED": _speed,
    "BREAK": _break,
    "SIGNAL": _signal,
    "TOOL": _tool,
    "DELAY": _delay,
    "WAIT": _wait,
    "TYPE": _type,
    "ACCEL": _accel,
    "DISABLE": _disable,
    "REACTE": _reacte,
    "ATTACH": _attach,
    "DETACH": _detach,
    "FOPENR": _fopenr,
    "FOPENW": _fopenw,
    "FCLOSE": _fclose,
    "READ": _read,
    "WRITE": _write,
}
