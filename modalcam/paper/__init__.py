"""`modalcam paper`: the tables and figures of the paper compared with the results of a folder of recordings."""
