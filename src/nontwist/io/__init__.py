"""Result files: runs as NetCDF, exports, and writing that leaves whole files."""
