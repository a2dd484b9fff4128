"""The job table, in SQLite or in PostgreSQL.

A job comes in once its image is stored.
Workers claim it and report how it went; table.py says what every job table must do.
"""
