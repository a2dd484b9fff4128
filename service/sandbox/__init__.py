"""One sandbox for everything that reads what strangers sent: images and bitstreams.

A task and an open file come in from the web process or a worker. A process that has the codec in memory forks; the fork
reads the file, confines itself, does this one task and ends. What it says leaves as frames, each checked before it is
believed.
"""
