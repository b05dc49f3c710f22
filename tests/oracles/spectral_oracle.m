% GNU Octave's answers for coherence, amplitudes and the shape of the density. Run in this folder:
%   octave-cli spectral_oracle.m [folder for the output files, default: here]
% Needs the package "signal". The committed outputs are those of Octave 7.3.0 with signal 1.4.3.
% pwelch_input.csv, mscohere_reference.csv: 1500 samples of made-up torques in Nm at 25600 Hz, one per line.
pkg load signal
arguments = argv();
folder = '.';
if numel(arguments) > 0
  folder = arguments{end};
end
fs = 25600;
torque = load('pwelch_input.csv');
reference = load('mscohere_reference.csv');
coherence_file = fopen(fullfile(folder, 'mscohere_coherence.csv'), 'w');
fprintf(coherence_file, 'n_samples,frequency_hz,coherence\n');
shape_file = fopen(fullfile(folder, 'spectral_shape.csv'), 'w');
fprintf(shape_file, 'n_samples,preset,name,value\n');
amplitude_file = fopen(fullfile(folder, 'amplitude_spectrum.csv'), 'w');
fprintf(amplitude_file, 'n_samples,n_fft,window,frequency_hz,amplitude\n');
for n = [1500 1152 90]
  x = torque(1:n);
  segment = fix(n / 4.5);
  n_fft = max(256, 2^nextpow2(segment));
  % Octave's own defaults differ from MATLAB's: everything is passed. mscohere takes no eighth argument, and
  % the range of real signals is one-sided by itself.
  [coherence, frequency] = mscohere(x, reference(1:n), hamming(segment), 0.5, n_fft, fs, 'none');
  for i = 1:numel(coherence)
    fprintf(coherence_file, '%d,%.17g,%.17g\n', n, frequency(i), coherence(i));
  end
  for preset = {'matlab_pwelch', 'ripple'}
    name = preset{1};
    if strcmp(name, 'matlab_pwelch')
      [psd, f] = pwelch(x, hamming(segment), 0.5, n_fft, fs, 'onesided', 'none');
    else
      [psd, f] = pwelch(x, hann(segment, 'periodic'), 0.5, n_fft, fs, 'onesided', 'short');
    end
    flatness = exp(mean(log(psd))) / mean(psd);  % paper A eq. 9
    centroid = sum(f .* psd) / sum(psd);
    rolloff = f(find(cumsum(psd) >= 0.95 * sum(psd), 1));
    near = zeros(size(f));
    for harmonic = 100:100:fs/2
      near = near | abs(f - harmonic) <= 30;
    end
    narrowband = sum(psd(logical(near))) / sum(psd);
    band = sum(psd(f >= 200 & f <= 3000)) * (f(2) - f(1));
    fprintf(shape_file, '%d,%s,spectral_flatness,%.17g\n', n, name, flatness);
    fprintf(shape_file, '%d,%s,spectral_centroid,%.17g\n', n, name, centroid);
    fprintf(shape_file, '%d,%s,spectral_rolloff,%.17g\n', n, name, rolloff);
    fprintf(shape_file, '%d,%s,narrowband_ratio,%.17g\n', n, name, narrowband);
    fprintf(shape_file, '%d,%s,band_power,%.17g\n', n, name, band);
  end
end
% Octave's flattopwin is another window than MATLAB's.
for window = {'hamming', 'hann', 'blackman', 'boxcar'}
  name = window{1};
  if strcmp(name, 'boxcar')
    w = ones(256, 1);
  else
    w = feval(name, 256);
  end
  power = zeros(129, 1);
  blocks = 0;
  for start = 0:128:(1500 - 256)
    transform = fft(w .* torque(start + (1:256)));
    power = power + abs(transform(1:129)).^2;
    blocks = blocks + 1;
  end
  amplitude = sqrt(power / blocks) / sum(w);
  amplitude(2:128) = 2 * amplitude(2:128);
  for i = 1:129
    fprintf(amplitude_file, '1500,256,%s,%.17g,%.17g\n', name, (i - 1) * 100, amplitude(i));
  end
end
fclose(coherence_file);
fclose(shape_file);
fclose(amplitude_file);
