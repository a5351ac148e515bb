"""The command graph: records, commands and the effects that follow. Pure: nothing here waits or does I/O."""
