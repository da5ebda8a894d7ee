"""gapmes.service.commands: one module per subcommand of `gapmes`, each a thin layer over library functions."""
