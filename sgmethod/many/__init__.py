"""Any number of pictures: a run over them, processes that share the cores, a manifest of what is done.

Pictures come in one by one and are never all in memory. Out come .sg files in a folder, and a line of JSON for each. A
run that was killed resumes where it ended.
"""
