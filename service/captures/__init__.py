"""Captures: cameras in one of several formats, with or without photographs beside them."""
