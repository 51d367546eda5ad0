"""One cycle of a task: its sweeps one after another on an open session, and the row they make.

Law of this file: a refused sweep is left out while another one succeeds; a cycle of which nothing is left is a fault.
"""

import logging
from collections.abc import Callable

from service.frontend.acquisition.evaluation import MeasuredRow, TaskEvaluation
from service.frontend.drivers.base import SweepRefusedError
from service.frontend.drivers.scpi_driver import ScpiDriver
from service.frontend.measurement_task import MeasurementTask, SweepPart
from service.frontend.tasks.task_plan import recheck
from service.records.levels.quality_flag import QualityFlag
from service.records.levels.sweep import Sweep

logger = logging.getLogger("service.frontend.acquisition.acquisition")

#: what says of a level that it was not looked for, or not in a fresh trace of numbers
_NOT_GOOD = QualityFlag.NOT_MEASURED | QualityFlag.STALE_TRACE | QualityFlag.NONFINITE_VALUE


class MeasuringCycle:
    """Cycles of one task on one session.

    Parameters
    ----------
    task : MeasurementTask
        Checked by the planner.
    evaluation : TaskEvaluation
        Outlives the session: it remembers which carriers were present.
    driver : ScpiDriver
        Of the open session, preset.
    keep_trace : callable
        Takes every sweep as evidence.
    """

    def __init__(
        self,
        task: MeasurementTask,
        evaluation: TaskEvaluation,
        driver: ScpiDriver,
        keep_trace: Callable[[Sweep], None],
    ) -> None:
        #: what the analyzer makes of the sweeps and the planner would not have let pass
        self.findings: dict[str, str] = {}
        self._task = task
        self._evaluation = evaluation
        self._driver = driver
        self._keep_trace = keep_trace
        self._sweeps = tuple(sweep for sweep in task.sweeps if task.carriers_of(sweep.id))
        self._configured = ""

    def configure(self) -> None:
        """Configure the first sweep, so that a task the analyzer cannot take shows before any row."""
        self._prepare(self._sweeps[0])

    def row(self) -> MeasuredRow:
        """Take all sweeps and return their row."""
        sweeps: dict[str, Sweep | None] = {}
        refusal: SweepRefusedError | None = None
        for sweep in self._sweeps:
            try:
                self._prepare(sweep)
                sweeps[sweep.id] = self._driver.measure(sweep)
            except SweepRefusedError as error:
                logger.warning("%s", error)
                self._configured = ""
                sweeps[sweep.id], refusal = None, error
        if refusal is not None and not any(sweeps.values()):
            raise refusal
        self._end(sweeps)
        extra = QualityFlag.SIMULATED if self._driver.features.has_dwell_epoch else QualityFlag(0)
        return self._evaluation.row(sweeps, extra=int(extra))

    def _end(self, sweeps: dict[str, Sweep | None]) -> None:
        """Keep the evidence, report what the analyzer said, give it back where it is shared."""
        for sweep in sweeps.values():
            if sweep is not None:
                self._keep_trace(sweep)
        for message in self._driver.analyzer_messages:
            logger.warning("the analyzer reports error %d %s", message.code, message.text)
        self._driver.analyzer_messages.clear()
        if self._task.task.analyzer.is_shared:
            self._driver.release()

    def _prepare(self, sweep: SweepPart) -> None:
        """Send and read back the settings of a sweep unless they stand; of a shared analyzer nothing is taken to."""
        if self._configured == sweep.id and not self._task.task.analyzer.is_shared:
            return
        actual = self._driver.configure(sweep, self._task.input)
        self._configured = sweep.id
        for finding in recheck(self._task, sweep, actual):
            text = f"{finding.subject}: {finding.detail}"
            if self.findings.get(finding.rule) != text:
                logger.warning("the analyzer changed the settings of the task: %s", finding)
            self.findings[finding.rule] = text


def is_good(row: MeasuredRow) -> bool:
    """Return whether at least one carrier of a row was looked for in a fresh trace of numbers."""
    return bool(((row.flags & int(_NOT_GOOD)) == 0).any())
