"""One sandbox for everything that reads uploads: images and bitstreams.

A task and an open file come in from the web process or a worker. A process with the codec in memory forks. The fork
reads the file, confines itself, does this one task and ends. Its messages are checked before they are used.
"""
