"""Parts shared by all commands: options of a machine, output files, printing, messages of failures."""
