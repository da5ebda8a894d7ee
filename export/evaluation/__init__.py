"""Measuring quality: held-out views of photographs and of generated scenes, beside baselines that learn nothing."""
