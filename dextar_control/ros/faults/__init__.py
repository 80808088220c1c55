"""The faults against the real nodes: the injector on the wire, the processes, the run of the cases."""
