"""``python -m oaisys_grpc.worker``: the server starts it."""

import sys

from oaisys_grpc.worker.program import main

sys.exit(main())
