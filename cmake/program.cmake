# filled when the program is there
