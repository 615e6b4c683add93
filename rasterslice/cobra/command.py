"""``rasterslice cobra simulate | serve | send``: reads arguments, calls one function, prints."""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ..errors import UsageError
from ..spool import open_result
from .bundle import Bundle, read_bundle, verify

#: A parser that reports as the others do; `cli` gives it.
ParserType = type[argparse.ArgumentParser]
Show = Callable[[Any, argparse.Namespace, Callable[[Any], list[str]]], None]
Say = Callable[[str], None]


_HELP = """usage: rasterslice cobra simulate DIR [--no-beads] [--trace FILE [--trace-layer N]] [--json]
       rasterslice cobra serve DIR --port PORT [--baud N] [--once] [--wait S]
       rasterslice cobra send  DIR --port PORT [--baud N] [--resume] [--tries N]

What becomes of the export of an Adept Cobra 600. DIR is an output folder sliced with --export cobra, or <stem>.cobra
in it.

  simulate   play the program as it is written: time, lengths, joints, valves, and the beads held against the part;
             exit code 2 when anything is at fault. RSCFG.V2 may have been edited: its frame and settings count
  serve      be the Kermit server from which V+ loads the files: LOAD K>RSPLAY.V2
  send       send the records line by line to rs.recv, where there is no Kermit; --resume after a broken line

Each has --help. PORT is a device or any pyserial URL: /dev/ttyUSB0, COM3, socket://host:port.

Nothing here turns on power, calibrates or starts a motion; that is the operator's. On the controller:
  LOAD RSPLAY, LOAD RSCFG     player and settings; the records <PART>.RSD stay a file
  EXECUTE 1 rs.guard()        first: shuts the valves whenever the player does not run
  EXECUTE rs.run()            play; DO rs.go = 0 ends it after the path that is being laid
  EXECUTE rs.safe()           after an ABORT: valves shut, then straight up
Read docs/cobra.md, its safety section and its checklist, before the first run."""


def run(argv: list[str], parser_type: Callable[..., Any], show: Show, say: Say) -> int:
    """Run one of the commands; return the exit code.

    Parameters
    ----------
    argv : list of str
        What follows ``rasterslice cobra``.
    parser_type, show, say : callable
        Of the command line: makes a parser, prints a result, prints progress.
    """
    commands = {"simulate": _simulate, "serve": _serve, "send": _send}
    if argv[:1] in (["--help"], ["-h"]):
        print(_HELP)
        return 0
    if not argv or argv[0] not in commands:
        got = f", got {argv[0]}" if argv and not argv[0].startswith("-") else ""
        raise UsageError(f"rasterslice cobra takes simulate, serve or send{got}; see rasterslice cobra --help")
    return commands[argv[0]](argv[1:], parser_type, show, say)


def _simulate(argv: list[str], parser_type: Callable[..., Any], show: Show, say: Say) -> int:
    parser = parser_type("rasterslice cobra simulate", description="Play an export and watch the arm and the valves.")
    parser.add_argument("folder", metavar="DIR", type=Path, help="output folder, or <stem>.cobra in it")
    parser.add_argument("--no-beads", action="store_true", help="do not compare beads with regions")
    parser.add_argument("--trace", metavar="FILE", type=Path, help="write time, tip, joints and valve of every tick")
    parser.add_argument("--trace-layer", metavar="N", type=int, help="the slice to trace; default 0")
    args = parser.parse_args(argv)
    if args.trace_layer is not None and args.trace is None:
        raise UsageError(f"--trace-layer {args.trace_layer} needs --trace FILE, where its ticks are written")
    report = simulation(read_bundle(args.folder), not args.no_beads, args.trace, args.trace_layer or 0)
    show(report, args, _lines)
    return 0 if not report["faults"] else UsageError.exit_code


def simulation(
    bundle: Bundle, beads: bool = True, trace: Path | None = None, trace_layer: int = 0
) -> dict[str, Any]:
    """Simulate a bundle and return what there is to say, as the JSON of ``cobra simulate``.

    Raises
    ------
    UsageError
        When a file is missing or altered, or holds what the interpreter does not know.
    """
    from .beads import compare
    from .simulate import prepare
    from .trace import Tracer

    start = time.perf_counter()
    verify(bundle)
    simulator = prepare(bundle)
    tracer = Tracer(simulator.profile, bundle.records, trace_layer) if trace is not None else None
    simulator.arm.watch = tracer
    result, deposits = simulator.play(), simulator.arm.deposits
    played = time.perf_counter() - start
    layers = open_result(bundle.folder.parent) if beads and (bundle.folder.parent / "layers").is_dir() else None
    rows = list(compare(bundle, layers, deposits)) if layers is not None and layers.regions else None
    if tracer is not None and trace is not None:
        tracer.write(trace)
    m = bundle.manifest
    for what, want, got in (("paths", m["paths"], result.paths), ("points", m["points"], result.points)):
        if want != got:
            result.fault(f"the manifest promises {want} {what}, {got} were played")
    out: dict[str, Any] = {
        "program": "rasterslice", "kind": "cobra simulation", "name": m["name"], "points": result.points,
        "paths": result.paths, "build_seconds": round(result.seconds, 1),
        "build_hours": round(result.seconds / 3600, 2),
        "wet_mm": {"part": round(result.wet[0], 1), "scaffold": round(result.wet[1], 1)},
        "lead_mm": round(result.lead, 1), "travel_mm": round(result.travel, 1), "tool_changes": result.changes,
        "holds": result.holds, "wet_speed_least": round(result.slowest, 4), "wet_speed_most": result.fastest,
        "valve_error_mm": round(result.valve_error, 4), "corner_rounding_mm": round(result.rounding, 4),
        "joints": {k: [round(x, 3) for x in v] for k, v in result.joints.items()},
        "joint_speeds": {k: round(v, 2) for k, v in result.joint_speeds.items()},
        "edited": simulator.edited, "messages": result.messages, "faults": result.faults,
        "seconds": {"play": round(played, 3), "beads": round(time.perf_counter() - start - played, 3)},
        "literal": None, "beads": None,
    }  # fmt: skip
    if simulator.has_literal:
        out["literal"] = _literal(bundle, result)
    if rows is not None:
        out["beads"] = _bead_summary(rows)
    return out


def _literal(bundle: Bundle, result: Any) -> dict[str, Any]:
    """Play the literal programs, which must come to the same; their faults are added to those of the player."""
    from .simulate import LITERAL, prepare

    literal = prepare(bundle).play(LITERAL)
    for fault in literal.faults:
        result.fault(f"{LITERAL}: {fault}")
    if (literal.paths, literal.points) != (result.paths, result.points):
        result.fault(f"{LITERAL} plays {literal.points} points in {literal.paths} paths, "
                     f"the player {result.points} in {result.paths}")  # fmt: skip
    return {"points": literal.points, "paths": literal.paths, "build_seconds": round(literal.seconds, 1)}


def _bead_summary(rows: list[Any]) -> dict[str, Any]:
    summary: dict[str, Any] = {}
    for material, name in enumerate(("part", "scaffold")):
        mine = [r for r in rows if r.material == material]
        summary[name] = {
            "region_mm2": round(sum(r.region for r in mine), 2),
            "uncovered_mm2": round(sum(r.uncovered for r in mine), 2),
            "outside_mm2": round(sum(r.outside for r in mine), 2),
        }
    summary["layers"] = [
        [r.layer, ("part", "scaffold")[r.material], r.pass_, round(r.region, 3), round(r.uncovered, 3),
         round(r.outside, 3)] for r in rows
    ]  # fmt: skip
    return summary


def _lines(r: dict[str, Any]) -> list[str]:
    wet = r["wet_mm"]
    lines = [
        f"points    {r['points']} in {r['paths']} paths",
        f"wet       {wet['part'] / 1000:.1f} m part, {wet['scaffold'] / 1000:.1f} m scaffold",
        f"dry       {r['lead_mm'] / 1000:.1f} m leads, {r['travel_mm'] / 1000:.1f} m travel",
        f"time      {r['build_hours']:.1f} h, {r['tool_changes']} tool changes, {r['holds']} holds",
        f"wet speed {r['wet_speed_least']:.4f} to {r['wet_speed_most']:.4f} of the commanded one",
        f"valves    {r['valve_error_mm']:.4f} mm off at worst; corners cut by {r['corner_rounding_mm']:.4f} mm",
        "joints    " + ", ".join(f"{k} {a:.1f} to {b:.1f}" for k, (a, b) in r["joints"].items()),
    ]
    for name in ("part", "scaffold") if r["beads"] else ():
        b = r["beads"][name]
        region = b["region_mm2"] or 1.0
        lines.append(
            f"{name:<9} {100 * b['uncovered_mm2'] / region:.3f} % not covered, "
            f"{100 * b['outside_mm2'] / region:.3f} % outside, of {b['region_mm2'] / 100:.1f} cm2"
        )
    if not r["beads"]:
        lines.append("beads     not compared: the output folder has no regions; slice with --export cobra")
    seconds = r["seconds"]
    lines.append(f"simulated in {seconds['play']:.1f} s, beads in {seconds['beads']:.1f} s")
    lines += [f"edited    {text}" for text in r["edited"]]
    return lines + [f"FAULT     {fault}" for fault in r["faults"]]


def _port_parser(parser_type: Callable[..., Any], name: str, description: str) -> Any:
    parser = parser_type(f"rasterslice cobra {name}", description=description)
    parser.add_argument("folder", metavar="DIR", type=Path, help="output folder, or <stem>.cobra in it")
    parser.add_argument("--port", metavar="PORT", required=True, help="device or any pyserial URL")
    parser.add_argument("--baud", metavar="N", type=int, default=9600, help="default 9600")
    parser.add_argument("--xonxoff", action="store_true", help="software flow control")
    parser.add_argument("--timeout", metavar="S", type=float, default=2.0, help="per answer; default 2 s")
    return parser


def _serve(argv: list[str], parser_type: Callable[..., Any], show: Show, say: Say) -> int:
    parser = _port_parser(parser_type, "serve", "Be the Kermit server that V+ loads files from.")
    parser.add_argument("--once", action="store_true", help="end when the client says so, or the line closes")
    parser.add_argument("--wait", metavar="S", type=float, default=0.0, help="how long nothing may come; 0: for ever")
    args = parser.parse_args(argv)
    if not 0 <= args.wait <= 1e6:
        raise UsageError(f"--wait must be 0, for ever, to 1000000 s, got {args.wait:g}")
    bundle = read_bundle(args.folder)
    verify(bundle)
    from .kermit import serve
    from .port import open_port

    with open_port(args.port, args.baud, args.timeout, args.xonxoff) as port:
        tell = say if not args.quiet else lambda text: None
        sent = serve(port, bundle.folder, tell, args.once, args.timeout, args.wait)
    show({"files": sent}, args, lambda r: [f"served {', '.join(r['files']) or 'nothing'}"])
    return 0


def _send(argv: list[str], parser_type: Callable[..., Any], show: Show, say: Say) -> int:
    parser = _port_parser(parser_type, "send", "Send the records to rs.recv, line by line. Starts nothing there.")
    parser.add_argument("--resume", action="store_true", help="go on where a broken line ended")
    parser.add_argument("--tries", metavar="N", type=int, default=5, help="of each line; default 5")
    args = parser.parse_args(argv)
    bundle = read_bundle(args.folder)
    verify(bundle)
    from .port import open_port
    from .sender import send_file

    def progress(done: int, total: int) -> None:
        if not args.quiet and (done % 500 == 0 or done == total):
            say(f"{done} of {total} records")

    with open_port(args.port, args.baud, args.timeout, args.xonxoff) as port:
        report = send_file(port, bundle.records, args.timeout, args.tries, args.resume, progress)
    show(report, args, lambda r: ["sent {records} records, {repeats} repeated".format(**r)])
    return 0
