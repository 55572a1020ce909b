"""The batched 2D wall-and-ray simulator: torch, and machine code for the CPU, tensors in and tensors out."""
