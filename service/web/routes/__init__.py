"""The routes: what the service answers, and how.

Requests that passed the guards come in.
Jobs go to the job table, images to the storage; answers in JSON and picture files leave.
"""
