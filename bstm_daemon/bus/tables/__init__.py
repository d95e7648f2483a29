"""Signal tables: CSV, Parquet and HDF5 with a column for each role."""
