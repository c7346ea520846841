"""The original's service, ``oaisys.Oaisys``, beside ours."""
