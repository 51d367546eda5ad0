"""A release service that writes down what it is asked for and answers what a test says: routes without an interlock."""

from dataclasses import dataclass, field, replace
from typing import Any

from service.core.control.slew_schedule import Envelope
from service.errors import SooError
from service.pipeline.control.release.control_verdict import ControlView, GoodMinutes, reason_of
from service.ports.archive import ListPart
from service.records.levels.attitude import Axes, Pulse
from service.records.operations.release import (
    Command,
    CommandCheck,
    CommandRequest,
    CommandState,
    ProductForm,
    Purpose,
    SignCheck,
    SignRatios,
    UplinkProduct,
)

#: 2026-11-21T03:00:00Z
AT_US = 1_795_230_000_000_000
S = 1_000_000
PULSES = (
    Pulse(AT_US + 60 * S, 4.0, Axes(0.0, 0.002, 0.0)),
    Pulse(AT_US + 300 * S, 4.0, Axes(0.0, -0.002, 0.0)),
)
CONTROL = ControlView(
    state="ARMED",
    since_us=AT_US,
    reasons=(reason_of("yaw_sign", AT_US),),
    trips=(),
    good_minutes=GoodMinutes(AT_US - 900 * S, 600.0, 600.0),
    condition_values={},
    has_row=True,
    is_armed=True,
    is_withheld=False,
    release="two_step",
    mode="ground",
    envelope=Envelope(),
    authorised_by=(),
    authorised_until_us=None,
    requested_by="Anna",
    requested_until_us=AT_US + 3600 * S,
    proven_axes=("roll",),
    open_commands=(7,),
    unreported_commands=(),
    sent_impulse_n_m_s=Axes(0.0, 0.016, 0.0),
    sign_check=SignCheck("roll", "plus", AT_US, "Anna", AT_US + 2700 * S, 2, 2, SignRatios(0.0, -12.0, -40.0)),
)
COMMAND = Command(
    counter=7,
    state=CommandState.PREPARED,
    digest="ab" * 32,
    purpose=Purpose.CONTROL,
    is_automatic=False,
    is_simulated=True,
    reason="roll is off",
    prepared_by="Anna",
    prepared_us=AT_US,
    expires_us=AT_US + 60 * S,
    attitude_epoch_us=AT_US - 30 * S,
    start_us=AT_US + 60 * S,
    stop_us=AT_US + 304 * S,
    schedule=PULSES,
    impulse_n_m_s=Axes(0.0, 0.0, 0.0),
    gross_impulse_n_m_s=Axes(0.0, 0.016, 0.0),
    angle_change_deg=Axes(0.0, 0.04, 0.0),
    rate_change_deg_s=Axes(0.0, 0.0, 0.0),
    peak_angle_deg=Axes(0.0, 0.04, 0.0),
    peak_rate_deg_s=Axes(0.0, 1.7e-4, 0.0),
    wheel_momentum_n_m_s=(0.0, 0.0, 0.0),
    checks=(CommandCheck("envelope", True, ""),),
)
PRODUCT = UplinkProduct(ProductForm.TORQUES, 7, AT_US, AT_US, AT_US + 60 * S, AT_US - 30 * S, True, "ab" * 32, PULSES)
ANGLES = UplinkProduct(
    ProductForm.ATTITUDE,
    41,
    AT_US,
    AT_US,
    AT_US + 210 * S,
    AT_US - 30 * S,
    True,
    attitude_deg=Axes(float("nan"), 0.02, -0.01),
    sigma_deg=Axes(0.2, 0.01, 0.01),
)


@dataclass
class ScriptedReleaseService:
    """Answers every request alike, or raises the error that a test has laid ready."""

    error: SooError | None = None
    asked: list[tuple[Any, ...]] = field(default_factory=list)
    command_view: Command = COMMAND
    control_view: ControlView = CONTROL

    def _answer(self, *asked: Any) -> None:
        self.asked.append(asked)
        if self.error is not None:
            raise self.error

    def control(self, spacecraft_id: str) -> ControlView:
        self._answer("control", spacecraft_id)
        return self.control_view

    def order(self, spacecraft_id: str, kind: Any, by: str) -> ControlView:
        self._answer("order", spacecraft_id, kind.value, by)
        return self.control_view

    def engage(self, spacecraft_id: str, by: str, **terms: Any) -> ControlView:
        self._answer("engage", spacecraft_id, by, terms)
        return self.control_view

    def prepare(self, spacecraft_id: str, by: str, request: CommandRequest, *, dry_run: bool = False) -> Command:
        self._answer("prepare", spacecraft_id, by, request, dry_run)
        return replace(self.command_view, is_dry_run=dry_run)

    def confirm(self, spacecraft_id: str, counter: int, by: str, digest: str, **said: Any) -> Command:
        self._answer("confirm", spacecraft_id, counter, by, digest, said)
        return replace(self.command_view, state=CommandState.RELEASED, confirmed_by=by, released_us=AT_US)

    def cancel(self, spacecraft_id: str, counter: int, by: str) -> Command:
        self._answer("cancel", spacecraft_id, counter, by)
        return replace(self.command_view, state=CommandState.CANCELLED)

    def report(self, spacecraft_id: str, counter: int, turn: str, **reported: Any) -> Command:
        self._answer("report", spacecraft_id, counter, turn, reported)
        return replace(self.command_view, state=CommandState[turn.upper()])

    def command(self, spacecraft_id: str, counter: int) -> Command:
        self._answer("command", spacecraft_id, counter)
        return self.command_view

    def commands(self, spacecraft_id: str, part: ListPart) -> list[Command]:
        self._answer("commands", spacecraft_id, part)
        later = replace(self.command_view, counter=8, prepared_us=AT_US + S)
        positions = [(each.prepared_us, each.counter) for each in (self.command_view, later)]
        after = part.after or (0, 0)
        views = (self.command_view, later)
        return [view for view, position in zip(views, positions, strict=True) if position > after][: part.limit]

    def product(self, spacecraft_id: str, form: ProductForm, counter: int) -> UplinkProduct:
        self._answer("product", spacecraft_id, form, counter)
        return PRODUCT

    def attitude_uplink(self, spacecraft_id: str) -> UplinkProduct:
        self._answer("attitude_uplink", spacecraft_id)
        return ANGLES

    def sign_check(self, spacecraft_id: str, axis: str, by: str) -> ControlView:
        self._answer("sign_check", spacecraft_id, axis, by)
        return self.control_view
