"""What a run leaves: observers that look on and write, and the checkpoints from which a run that was cut short goes on.

A sink is a file here and a row of `table.SINKS`.
"""
