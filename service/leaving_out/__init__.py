"""gapmes.service.leaving_out: what a scene does not need, left out within a proved bound."""
