"""What the commands do, as functions: arrays and folders in, frozen results out. `mphygs` names them all."""
