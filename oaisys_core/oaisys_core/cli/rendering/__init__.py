"""The command ``oaisys render``: its batches, samples, poses and progress."""
