"""gapmes.service.commands: one module per subcommand of `gapmes`, each a thin edge over the functions it calls."""
