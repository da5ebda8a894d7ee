"""gapmes.model: the GaPMeS network in torch, its weights and the recipe that trained them."""
