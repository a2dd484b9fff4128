"""The command line: sgmethod encode, preview, decode, info and compare.

A command reads arguments and files; it writes files, a summary or one line of error, and returns an exit status.
"""
