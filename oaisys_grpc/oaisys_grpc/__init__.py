"""The simulator behind gRPC: server, worker, client and their contract."""
