"""The service that answers: version, clock, settings without secrets, licences."""

from platform import python_version

from fastapi import APIRouter

from service.api.context.dependencies import Context
from service.api.schemas.about import AboutAnswer, ClockAnswer, SettingAnswer, ShippedAnswer
from service.api.views.shipped import program_version, shipped_distributions

router = APIRouter(tags=["health"])


@router.get("/about")
def get_about(context: Context) -> AboutAnswer:
    """Return version, clock, settings in force without secrets, and the licences of what is installed with it."""
    return AboutAnswer(
        version=program_version(),
        python=python_version(),
        clock=ClockAnswer.model_validate({"now": context.clock.system_us(), "kind": context.clock_kind}),
        settings=[SettingAnswer.model_validate(entry._asdict() | {"unit": entry.unit}) for entry in context.settings],
        shipped=[ShippedAnswer(**each._asdict()) for each in shipped_distributions()],
    )
