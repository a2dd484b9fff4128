"""The command line: sgmethod encode, preview, decode, info, compare and plot.

A command reads arguments and files; it writes files, a summary or one line of error, and returns an exit status.
"""
