"""The attitude filter: prediction, common changes, carrier faults, rain, integrity."""
