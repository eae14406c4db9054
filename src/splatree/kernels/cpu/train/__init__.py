"""What training needs beside the frame: the loss against a photograph, and the optimiser's step."""
