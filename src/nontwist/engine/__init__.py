"""What all compiled schemes share, knowing none by name: layout, march, loads of the state, what is observed."""
