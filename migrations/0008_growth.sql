-- How fast the vibration of a stable stretch dies out, as its stability margin was read; its line is in line_hz.
ALTER TABLE cut ADD COLUMN growth_1_s REAL;
ALTER TABLE cut ADD COLUMN growth_se_1_s REAL;
