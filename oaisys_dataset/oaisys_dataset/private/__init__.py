"""Private parts of other libraries, one module each; see `oaisys_core.private`."""
