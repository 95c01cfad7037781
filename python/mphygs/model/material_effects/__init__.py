"""Effects that change the material, one file each: a file added here is an effect added everywhere."""
