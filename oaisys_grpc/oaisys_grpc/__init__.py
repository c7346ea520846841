"""The simulator behind gRPC: server, worker, client and their contract."""

import os
import sys

# gRPC reads it once. By default it writes a line for each failed handshake, whoever caused it.
os.environ.setdefault("GRPC_VERBOSITY", "ERROR")

if sys.argv[:1] == ["-m"] and not sys.flags.safe_path:  # as in `python -m oaisys_grpc`
    del sys.path[0]  # the current folder, whose files nothing may import
