"""What all compiled schemes share, knowing none of them by name: layout, march, loads of the state, what is watched."""
