"""One module for each figure and table of the thesis: what to run, how to judge it, how to draw it."""
