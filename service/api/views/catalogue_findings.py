"""Places and frequencies of the catalogue: faults become a problem, warnings go into the answer."""

from service.api.problems.problems import MAX_FAULTS, invalid_request
from service.api.schemas.base import CatalogueWarning
from service.pipeline.inputs.catalogue_checks import CatalogueFindings


def accepted_findings(found: CatalogueFindings) -> list[CatalogueWarning]:
    """Return the warnings of what was found; a 422 names the faults when there are any."""
    if found.faults:
        raise invalid_request(found.faults[:MAX_FAULTS])
    return [CatalogueWarning.model_validate(warning) for warning in found.warnings]
