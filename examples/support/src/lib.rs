//! File formats, command line, plots and progress bars of the examples: all I/O of the repository lives here.
