% Density of a worn disc's torque, and its coherence with a healthy one's.
load('rig.mat')  % healthy, worn, fs

% In MATLAB these two lines are all:
%   [pxx, f] = pwelch(worn, [], [], [], fs);
%   cxy = mscohere(worn, healthy, [], [], [], fs);

% GNU Octave has other defaults than MATLAB, so everything is passed:
pkg load signal
n = floor(numel(worn) / 4.5);
n_fft = max(256, 2^nextpow2(n));
[pxx, f] = pwelch(worn, hamming(n), 0.5, n_fft, fs, 'onesided', 'none');
cxy = mscohere(worn, healthy, hamming(n), 0.5, n_fft, fs, 'none');

save('-v7', 'spectra.mat', 'f', 'pxx', 'cxy')
