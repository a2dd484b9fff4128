"""Any number of pictures: a run over them, processes that share the cores, a manifest of what is done.

Pictures are taken one by one, and are never all in memory. The result is a folder of .sg files, with a line of JSON for
each. A run that was killed can resume where it stopped.
"""
