"""The command line: sgmethod encode, decode, info, compare and plot.

Arguments and files come in.
Files, one summary or one line of error, and an exit status leave.
"""
