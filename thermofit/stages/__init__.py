"""One module per subcommand: Records and config in, Record out."""
