"""gapmes.service.matching: where photographs match, and what that tells of cameras, depths and exposures."""
