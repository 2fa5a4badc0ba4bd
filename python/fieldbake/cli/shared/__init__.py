"""Options, tables and files that several commands share."""
