"""Studies: measurements that the documentation shows. Each writes a file of docs/measured."""
