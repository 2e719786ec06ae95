"""Reports of runs, pictures of lamps, tables and exports."""
