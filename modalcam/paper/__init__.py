"""`modalcam paper`: the tables and figures of the paper beside what a folder of recordings gives."""
