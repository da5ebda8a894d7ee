"""The stability table: stiff and extreme cases, ours beside what plain float32 gives, both against a reference."""
