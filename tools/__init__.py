"""Programs that write files of the product: run one after a change to what it reads, and commit what it writes."""
