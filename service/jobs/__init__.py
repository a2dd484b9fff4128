"""The job table, in SQLite or in PostgreSQL.

A job comes in once its image is stored. Workers claim the job and report the outcome. table.py is the job table;
sqlite.py and postgres.py connect it to a database, and migrations.py brings its tables to today's version.
"""
