"""What a run leaves behind: the run folder, traces, plots and files for ParaView."""
