"""Runs ``RSPLAY.V2`` with its settings and records, and watches what the arm and the valves would do.

The program text is interpreted as it is (`vplus`); the motions it asks for are timed by a model (`chains`): one motion
is taken ahead, a signal goes out on the tick after its motion begins, the drop follows after the delay in the profile.
Frame, tools, valves, speeds and places are those of ``RSCFG.V2``, whatever the export had.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from ..errors import UsageError
from ..profile import Profile
from .arm import Arm
from .bundle import Bundle
from .config import configured, faults_of
from .desk import Desk
from .places import check_profile
from .vplus import Program
from .watch import Deposit, Result

_STEPS = 4  # turns of loops that a record may take: one to read it, one to play it
_MORE = 10_000
LITERAL = "rs.lit"


@dataclass(frozen=True, slots=True)
class Simulator:
    """A bundle, ready to be played.

    Attributes
    ----------
    program : Program
        All its ``.V2`` files.
    arm : Arm
        The host of the program.
    edited : list of str
        How ``RSCFG.V2`` differs from the export.
    """

    program: Program
    arm: Arm
    edited: list[str]

    @property
    def profile(self) -> Profile:
        """The profile, with the settings of ``RSCFG.V2``."""
        return self.arm.profile

    @property
    def has_literal(self) -> bool:
        """Whether there are literal programs: ``rs.lit``."""
        return LITERAL in self.program.names

    def play(self, name: str = "rs.run") -> Result:
        """Run a program to its end; literal ones are held against the records, too."""
        if name == LITERAL:
            self.arm.desk.audit()
        self.program.call(name)
        return self.arm.finish()


def prepare(
    bundle: Bundle, start: tuple[float, ...] | None = None, fail_at: int | None = None
) -> Simulator:
    """Read the programs of a bundle and its settings.

    Parameters
    ----------
    bundle : Bundle
    start, fail_at
        As for `Arm`.

    Raises
    ------
    UsageError
        When a file is missing, or holds what the interpreter does not know.
    """
    try:
        files = {f.name: f.read_bytes().decode("ascii", "replace") for f in sorted(bundle.folder.glob("*.V2"))}
        settings = {"RSCFG.V2": files["RSCFG.V2"]}
    except OSError as error:
        raise UsageError(f"{error.filename}: {error.strerror}; export again") from None
    except KeyError:
        raise UsageError(f"{bundle.folder}: RSCFG.V2 is missing; export again") from None
    profile, edited = configured(bundle.profile, Program(settings, None, _MORE))
    result = Result()
    desk = Desk(profile, bundle.folder, bundle.manifest, result)
    arm = Arm(profile, desk, result, start, fail_at)
    for fault in faults_of(profile, bundle.profile):
        result.fault(fault)
    try:
        check_profile(profile)
    except UsageError as error:
        result.fault(str(error))
    steps = _MORE + _STEPS * int(bundle.manifest["records"])
    return Simulator(Program(files, arm, steps, desk), arm, edited)


def simulate(bundle: Bundle, take: Callable[[Deposit], None] | None = None) -> Result:
    """Play a bundle.

    Parameters
    ----------
    bundle : Bundle
    take : callable, optional
        Given every deposit in order.

    Raises
    ------
    UsageError
        When the program holds what the interpreter does not know, asks for what the model has not, or never ends.
    """
    simulator = prepare(bundle)
    result = simulator.play()
    if take is not None:
        for deposit in simulator.arm.deposits:
            take(deposit)
    return result
