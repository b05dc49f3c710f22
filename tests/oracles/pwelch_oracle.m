% GNU Octave's answers for cyclofeat.signal. Run in this folder:
%   octave-cli pwelch_oracle.m [folder for the two output files, default: here]
% Needs the package "signal". The committed outputs are those of Octave 7.3.0 with signal 1.4.3.
% (A script of the name pwelch.m would hide the function.)
% pwelch_input.csv: 1500 samples of a made-up torque in Nm at 25600 Hz, one per line.
pkg load signal
arguments = argv();
folder = '.';
if numel(arguments) > 0
  folder = arguments{end};
end
fs = 25600;
torque = load('pwelch_input.csv');
psd_file = fopen(fullfile(folder, 'pwelch_psd.csv'), 'w');
fprintf(psd_file, 'n_samples,preset,frequency_hz,psd\n');
scalar_file = fopen(fullfile(folder, 'pwelch_scalars.csv'), 'w');
fprintf(scalar_file, 'n_samples,preset,name,value\n');
for n = [1500 1152 9]  % padded, not padded (segments of 256), segments of two samples
  x = torque(1:n);
  segment = fix(n / 4.5);
  n_fft = max(256, 2^nextpow2(segment));
  for preset = {'matlab_pwelch', 'ripple'}
    name = preset{1};
    % Octave's own defaults differ from MATLAB's (mean removed, other segments): everything is passed.
    if strcmp(name, 'matlab_pwelch')
      [psd, frequency] = pwelch(x, hamming(segment), 0.5, n_fft, fs, 'onesided', 'none');
    else
      [psd, frequency] = pwelch(x, hann(segment, 'periodic'), 0.5, n_fft, fs, 'onesided', 'short');
    end
    for i = 1:numel(psd)
      fprintf(psd_file, '%d,%s,%.17g,%.17g\n', n, name, frequency(i), psd(i));
    end
    p = psd / sum(psd);  % paper A eq. 4
    normalized = -sum(p .* log2(p + eps)) / log2(numel(p));  % eq. 5-7
    p = p(p > 0);
    fprintf(scalar_file, '%d,%s,shannon_entropy,%.17g\n', n, name, -sum(p .* log2(p)));  % eq. 8
    fprintf(scalar_file, '%d,%s,normalized_entropy,%.17g\n', n, name, normalized);
  end
  rms_value = sqrt(mean(x .^ 2));
  names = {'min', 'max', 'mean', 'std', 'range', 'rms', 'crest_factor', 'skewness', 'kurtosis', 'ripple'};
  values = [min(x), max(x), mean(x), std(x), range(x), rms_value, max(abs(x)) / rms_value, ...
            skewness(x), kurtosis(x), std(x) / abs(mean(x))];
  for i = 1:numel(values)
    fprintf(scalar_file, '%d,,%s,%.17g\n', n, names{i}, values(i));
  end
end
fclose(psd_file);
fclose(scalar_file);
